"""Acceptance K4, K6, K8: damage is found, one writer at a time, what is acknowledged stays."""

from __future__ import annotations

import json
import random
import re
import sqlite3
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest

from hhtbench.campaign.store import RunRow, Store, load_rows, reading
from hhtbench.campaign.store.sqlite import Entry
from hhtbench.protocol.errors import ProblemError

ROW = RunRow(
    key="k0",
    problem="fall",
    solver="told",
    request={"rtol": 1e-3, "max_seconds": 1.0},
    status="success",
    message="there",
    metrics={"t_end": 1.0},
    series={"drift": {"t": [random.Random(i).random() for i in range(150)]}},
    timing={"repeats": None},
    created="2026-01-01T00:00:00+00:00",
)


def fill(path: Path, count: int = 10) -> list[RunRow]:
    rows = [replace(ROW, key=f"k{i}", metrics={"t_end": float(i)}) for i in range(count)]
    with Store(path) as store:
        for row in rows:
            store.put(row, f"identity {row.key}")
    return rows


def test_rows_come_back_as_they_were_written(tmp_path: Path):
    rows = fill(tmp_path / "runs.db")
    assert load_rows(tmp_path / "runs.db") == rows
    with Store(tmp_path / "runs.db") as store:
        assert [store.get(row.key) for row in rows] == rows
        assert store.get("absent") is None
        assert store.repairs == ()


def test_a_message_that_is_no_unicode_is_kept_readable(tmp_path: Path):
    with Store(tmp_path / "runs.db") as store:
        store.put(replace(ROW, message="cannot read b\udcffc"), "cell")
    (row,) = load_rows(tmp_path / "runs.db")
    assert row.message == "cannot read b\\udcffc"


def test_rows_that_are_written_again_keep_their_places(tmp_path: Path):
    path = tmp_path / "runs.db"
    fill(path, 4)
    with Store(path) as store:
        store.put(replace(ROW, key="k1", timing={"repeats": 3}), "identity k1")  # timed
        store.put(replace(ROW, key="new"), "identity k2")  # its sources have changed
    rows = load_rows(path)
    assert [row.key for row in rows] == ["k0", "k1", "new", "k3"]
    assert rows[1].timing == {"repeats": 3}


def test_curves_are_packed(tmp_path: Path):
    row = replace(ROW, series={"drift": {"t": [0.125 * i for i in range(20_000)]}})
    with Store(tmp_path / "runs.db") as store:
        store.put(row, "cell")
        assert store.get(row.key) == row
    assert (tmp_path / "runs.db").stat().st_size < 0.5 * len(json.dumps(row.series))


def test_a_number_that_is_not_finite_is_never_written(tmp_path: Path):
    with Store(tmp_path / "runs.db") as store, pytest.raises(ValueError, match="not JSON compliant"):
        store.put(replace(ROW, metrics={"t_end": float("nan")}), "cell")


def test_a_flipped_byte_in_a_row_is_found_and_the_row_given_up(tmp_path: Path):
    path = tmp_path / "runs.db"
    fill(path)
    content = bytearray(path.read_bytes())
    place = content.find(b'{"t_end": 4.0}')
    content[place + 10] ^= 1  # 4.0 reads 5.0: valid JSON, valid SQLite
    path.write_bytes(content)
    with pytest.warns(UserWarning, match=r"1 row cannot be read: fall, told, rtol=0.001 \(number 5 in the file\)"):
        assert [row.key for row in load_rows(path)] == [f"k{i}" for i in range(10) if i != 4]
    with Store(path) as store:
        assert "9 sound rows were saved" in store.repairs[0]
        assert "1 row cannot be read: fall, told, rtol=0.001" in store.repairs[1]
        assert store.get("k4") is None
    (aside,) = tmp_path.glob("runs.db.damaged-*")
    assert aside.read_bytes() == content  # nothing is overwritten
    with Store(path) as store:
        assert store.repairs == ()


def test_a_damaged_index_that_would_hide_a_row_is_found_and_rebuilt(tmp_path: Path):
    path = tmp_path / "runs.db"
    rows = fill(path)
    content = bytearray(path.read_bytes())
    content[content.index(b"k3")] = ord("j")  # the index lies before the rows
    path.write_bytes(content)
    with Store(path) as store:
        assert "10 sound rows were saved" in store.repairs[0]
        assert [store.get(row.key) for row in rows] == rows


def flips(sound: bytes, count: int) -> Iterator[bytes]:
    """The file with one bit changed, at every second time in its schema."""
    places, schema = random.Random(5), sound.index(b"CREATE TABLE")
    for number in range(count):
        content = bytearray(sound)
        place = places.randrange(schema, schema + 600) if number % 2 else places.randrange(len(content))
        content[place] ^= 1 << places.randrange(8)
        yield bytes(content)


def test_no_flipped_byte_is_used_silently(tmp_path: Path):
    """Every row that comes back, to a report or to a runner, is one that was written; what is missing is said."""
    path = tmp_path / "runs.db"
    rows = fill(path, 5)
    for content in flips(path.read_bytes(), 200):
        path.write_bytes(content)
        with warnings.catch_warnings(record=True) as told, suppress(ProblemError):
            warnings.simplefilter("always")
            kept = load_rows(path)
            assert all(row in rows for row in kept)
            assert len(kept) == len(rows) or re.search("can be read|cannot be read", str(told[0].message))
        try:
            with Store(path) as store:
                found = [store.get(row.key) for row in rows]
        except ProblemError as error:
            assert any(text in str(error) for text in ("version", "cannot be opened", "is no store"))
        else:
            assert all(got is None or got == row for got, row in zip(found, rows, strict=True))
            assert all(found) or store.repairs


def test_what_lies_behind_a_zeroed_page_is_read_and_what_lay_on_it_is_told(tmp_path: Path):
    path = tmp_path / "runs.db"
    rows = fill(path, 60)
    sound = path.read_bytes()
    size = int.from_bytes(sound[16:18], "big")
    for page in range(1, len(sound) // size):
        path.write_bytes(sound[: page * size] + bytes(size) + sound[(page + 1) * size :])
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            kept = load_rows(path)
        assert all(row in rows for row in kept)
        assert kept == sorted(kept, key=rows.index)
        assert told, page
        lost = len(rows) - len(kept)
        text = str(told[0].message)
        assert f"{lost} row" in text or (lost == 60 and "none of its rows can be read" in text) or not lost
        with Store(path) as store:
            assert sum(store.get(row.key) == row for row in rows) == len(kept)
            assert f"{len(kept)} sound rows were saved" in store.repairs[0]


def test_a_newer_store_is_refused_and_left_as_it_is_by_reader_and_writer(tmp_path: Path):
    path = tmp_path / "runs.db"
    fill(path, 3)
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE meta SET value = '3'")
        connection.execute("ALTER TABLE runs ADD COLUMN more TEXT")
        connection.execute("CREATE TABLE pairs (name TEXT)")
    before = path.read_bytes()
    for use in (load_rows, Store):
        with pytest.raises(ProblemError, match="a store of version 3, this hhtbench knows version 2"):
            use(path)
    assert path.read_bytes() == before
    assert not list(tmp_path.glob("runs.db.*-*"))


def test_a_store_that_another_program_locks_is_no_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "runs.db"
    rows = fill(path, 3)
    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda *args, **options: connect(*args, **{**options, "timeout": 0.05}))
    other = connect(path, isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    for use in (load_rows, Store):
        with pytest.raises(ProblemError, match="locked"):
            use(path)
    other.close()
    assert load_rows(path) == rows
    assert not list(tmp_path.glob("runs.db.*-*"))


def test_the_first_row_of_a_key_stays_and_one_that_differs_is_told(tmp_path: Path):
    path = tmp_path / "runs.db"
    again = replace(ROW, timing={"solve_s": 9.0}, created="2026-02-02T00:00:00+00:00")
    other = replace(ROW, counters={"steps_accepted": 7})
    with Store(path) as store:
        assert store.write([Entry(row=ROW, identity="cell")]) == []
        assert store.write([Entry(row=again, identity="cell"), Entry(row=other, identity="cell")]) == [other]
        assert store.get(ROW.key) == ROW
        store.put(other, "cell")
        assert store.get(ROW.key) == other


def test_rows_that_are_written_together_are_written_all_or_none(tmp_path: Path):
    path = tmp_path / "runs.db"
    broken = replace(ROW, key="k1", metrics={"t_end": float("nan")})
    with Store(path) as store, pytest.raises(ValueError, match="not JSON"):
        store.write([Entry(row=ROW, identity="cell"), Entry(row=broken, identity="other")])
    assert load_rows(path) == []


def test_two_runners_by_two_names_of_one_file_are_kept_apart(tmp_path: Path):
    path, link = tmp_path / "runs.db", tmp_path / "folder" / "link.db"
    link.parent.mkdir()
    link.symlink_to(path)
    with Store(path), pytest.raises(ProblemError, match="another"):
        Store(link)
    with Store(link) as store:
        store.put(ROW, "cell")
        with pytest.raises(ProblemError, match="another"):
            Store(path)
    assert load_rows(path) == [ROW]
    assert link.is_symlink()


def test_a_damaged_file_that_cannot_be_saved_from_is_left_as_it_is(tmp_path: Path):
    path = tmp_path / "runs.db"
    fill(path, 60)
    content = path.read_bytes()[: 20 * 4096]
    path.write_bytes(content)
    limited = "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (9_000, 9_000))\n" + OPENS
    told = subprocess.run([sys.executable, "-c", limited, str(path)], capture_output=True, text=True, check=False)
    assert "cannot be saved" in told.stdout, told
    assert path.read_bytes() == content
    assert [entry.name for entry in tmp_path.iterdir() if entry.suffix != ".lock"] == ["runs.db"]


def test_a_folder_that_cannot_be_written_is_told():
    with pytest.raises(ProblemError, match="cannot be written"):
        Store("/proc/runs.db")


def test_a_truncated_file_is_set_aside_and_only_rows_that_are_whole_are_used(tmp_path: Path):
    path = tmp_path / "runs.db"
    rows = fill(path, 200)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with Store(path) as store:
        assert "damaged" in store.repairs[0]
        kept = [row for row in rows if store.get(row.key) == row]
    assert load_rows(path) == kept
    assert list(tmp_path.glob("runs.db.damaged-*"))


def test_a_file_that_was_cut_off_to_nothing_is_told(tmp_path: Path):
    path = tmp_path / "runs.db"
    fill(path)
    path.write_bytes(b"")
    with Store(path) as store:
        assert store.repairs == ("the file is empty; if it has held rows, they are gone and their cells run again.",)
    with Store(path) as store:
        assert store.repairs == ()


def test_an_older_copy_of_the_file_in_its_place_is_told(tmp_path: Path):
    path = tmp_path / "runs.db"
    rows = fill(path, 4)
    older = path.read_bytes()
    with Store(path) as store:
        assert store.repairs == ()
        store.put(replace(ROW, key="late"), "late")
        newer = path.read_bytes()  # as a runner that is killed here leaves it
        path.write_bytes(older)
    with Store(path) as store:
        assert store.get("late") is None and store.get("k3") == rows[3]
        assert "an older copy" in store.repairs[0]
    path.write_bytes(newer)
    with Store(path) as store:
        assert store.repairs == ()
    path.unlink()
    with Store(path) as store:  # begun anew
        assert store.repairs == ()


def test_a_file_that_is_no_store_is_refused_and_left_as_it_is(tmp_path: Path):
    path = tmp_path / "notes.db"
    path.write_text("my notes " * 500)
    with pytest.raises(ProblemError, match="is no store"):
        Store(path)
    assert path.read_text() == "my notes " * 500
    foreign = tmp_path / "foreign.db"
    with sqlite3.connect(foreign) as connection:
        connection.execute("CREATE TABLE songs (title TEXT)")
    before = foreign.read_bytes()
    with pytest.raises(ProblemError, match="is no store: it has a table songs"):
        Store(foreign)
    assert foreign.read_bytes() == before


OPENS = """
from hhtbench.protocol.errors import ProblemError
from hhtbench.campaign.store import Store
try:
    Store(sys.argv[1])
except ProblemError as error:
    print(error)
"""
KILLED = """
import os, signal, sqlite3, sys
connection = sqlite3.connect(sys.argv[1])
connection.execute("PRAGMA cache_size = 1")
connection.execute("BEGIN")
connection.execute("UPDATE runs SET status = 'half', message = message || hex(zeroblob(20000))")
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("first", [load_rows, lambda path: Store(path).close()])
def test_what_a_killed_writer_had_begun_is_rolled_back(tmp_path: Path, first: Callable[[Path], object]):
    path = tmp_path / "runs.db"
    rows = fill(path, 50)
    subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False)
    assert path.with_name("runs.db-journal").exists()
    first(path)
    assert load_rows(path) == rows


def test_a_file_of_another_kind_beside_the_journal_of_a_killed_writer_is_refused_untouched(tmp_path: Path):
    path = tmp_path / "runs.db"
    fill(path, 50)
    subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False)
    journal = path.with_name("runs.db-journal")
    before = b"a text of somebody's\n" * 3000, journal.read_bytes()
    path.write_bytes(before[0])
    with pytest.raises(ProblemError, match="another kind of file"):
        load_rows(path)
    assert (path.read_bytes(), journal.read_bytes()) == before


def test_a_second_writer_is_refused_and_the_lock_ends_with_the_first(tmp_path: Path):
    path = tmp_path / "runs.db"
    with Store(path), pytest.raises(ProblemError, match="another"):
        Store(path)
    Store(path).close()


def test_a_store_that_cannot_be_written_says_so_and_keeps_its_rows(tmp_path: Path):
    path = tmp_path / "runs.db"
    with Store(path) as store:
        store.put(ROW, "cell")
        store._connection.execute("PRAGMA max_page_count = 1")
        with pytest.raises(ProblemError, match=r"cannot be written.*full"):
            store.put(replace(ROW, key="k1", message="x" * 100_000), "other")
    assert load_rows(path) == [ROW]


def test_wrong_places_are_refused(tmp_path: Path):
    with pytest.raises(ProblemError, match="no folder"):
        Store(tmp_path / "absent" / "runs.db")
    with pytest.raises(ProblemError, match="no store"):
        load_rows(tmp_path / "absent.db")


def test_rows_are_on_the_disk_when_put_returns(tmp_path: Path):
    with Store(tmp_path / "runs.db") as store:
        assert store._connection.execute("PRAGMA synchronous").fetchone()[0] == 3  # EXTRA
        assert store._connection.execute("PRAGMA journal_mode").fetchone()[0] == b"delete"
        store.put(ROW, "cell")
        assert load_rows(tmp_path / "runs.db") == [ROW]  # seen from another connection: committed
    assert reading.VERSION == 2
