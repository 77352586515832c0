"""Acceptance K4, K5, K11: whatever byte of database or journal is changed or missing, no wrong row is used; and 1e5 rows.

Long, ``make test-faults``; test_store.py has the short part.
"""

from __future__ import annotations

import random
import shutil
import statistics
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from hhtbench.campaign.store import RunRow, Store
from hhtbench.campaign.store.sqlite import Entry
from hhtbench.protocol.errors import ProblemError
from tests.campaign.test_store import KILLED, ROW, fill

pytestmark = pytest.mark.long

FLIPS = 400
MANY = 100_000
REFUSED = ("version", "cannot be opened", "is no store")  # what was asked for is said, and nothing is used or changed


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, bytes], list[RunRow]]:
    """A store whose writer was killed in the midst of changing every row: database, journal, and the rows before."""
    path = tmp_path_factory.mktemp("killed") / "runs.db"
    rows = fill(path, 20)
    subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False)
    files = {name: path.with_name(f"runs.db{name}").read_bytes() for name in ("", "-journal")}
    assert files["-journal"], "it was in the midst"
    return files, rows


def opened(folder: Path, files: dict[str, bytes], rows: list[RunRow]) -> str:
    """How a runner fares with these files: "whole", "told" what is missing, "refused", or what is wrong."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for name, content in files.items():
        (folder / f"runs.db{name}").write_bytes(content)
    try:
        with Store(folder / "runs.db") as store:
            kept = [store.get(row.key) for row in rows]
            repairs = store.repairs
    except ProblemError as error:
        return "refused" if any(text in str(error) for text in REFUSED) else str(error)
    if any(got is not None and got != row for got, row in zip(kept, rows, strict=True)):
        return "a wrong row"
    return "whole" if all(kept) else "told" if repairs else "lost in silence"


def flipped(content: bytes, chance: random.Random) -> bytes:
    changed = bytearray(content)
    changed[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
    return bytes(changed)


@pytest.mark.parametrize("name", ["", "-journal"])
def test_a_flipped_bit_in_database_or_journal_of_a_killed_writer_is_told_or_harmless(
    killed: tuple[dict[str, bytes], list[RunRow]], tmp_path: Path, name: str
):
    files, rows = killed
    chance = random.Random(4)
    ends = Counter(opened(tmp_path / "store", {**files, name: flipped(files[name], chance)}, rows) for _ in range(FLIPS))
    assert ends.keys() <= {"whole", "told", "refused"}, ends
    assert ends["whole"] > 0


@pytest.mark.parametrize(
    "spoil",
    [
        lambda files: {"": files[""]},
        lambda files: {**files, "-journal": b""},
        lambda files: {**files, "-journal": bytes(len(files["-journal"]))},
    ],
    ids=["deleted, or the database copied alone", "empty", "zeros"],
)
def test_without_its_journal_what_a_killed_writer_had_begun_is_not_used(
    killed: tuple[dict[str, bytes], list[RunRow]], tmp_path: Path, spoil: Callable[[dict[str, bytes]], dict[str, bytes]]
):
    files, rows = killed
    assert opened(tmp_path / "store", spoil(files), rows) == "told"


@pytest.mark.parametrize("name", ["", "-journal"])
def test_a_file_that_ends_anywhere_is_told_or_harmless(
    killed: tuple[dict[str, bytes], list[RunRow]], tmp_path: Path, name: str
):
    files, rows = killed
    ends = Counter(
        opened(tmp_path / "store", {**files, name: files[name][:end]}, rows) for end in range(0, len(files[name]), 1499)
    )
    assert ends.keys() <= {"whole", "told", "refused"}, ends


def test_the_work_of_writing_a_row_does_not_grow_with_their_number_and_stays_below_five_milliseconds(tmp_path: Path):
    """Counted in instructions of SQLite's machine, by tens: pages of an index become one level more, no more.

    The time is the processor's: it does not wait for the disk, nor for others.
    """
    with Store(tmp_path / "runs.db") as store:
        few, many = (work_of_a_row(store, count) for count in (1_000, MANY))
        assert many <= 1.5 * few
        rows = [replace(ROW, key=f"late {i}") for i in range(21)]
        assert statistics.median(seconds_of(store, row) for row in rows) < 5e-3


def seconds_of(store: Store, row: RunRow) -> float:
    """Of the processor, to write it."""
    began = time.process_time()
    store.put(row, row.key)
    return time.process_time() - began


def work_of_a_row(store: Store, count: int) -> int:
    """Of the next ten rows, once there are ``count``."""
    here = store._connection.execute("SELECT count(*) FROM runs").fetchone()[0]
    small = replace(ROW, series={})
    store.write(Entry(row=replace(small, key=f"k{i}"), identity=f"i{i}") for i in range(here, count))
    work = 0

    def step() -> int:
        nonlocal work
        work += 1
        return 0

    store._connection.set_progress_handler(step, 10)
    for i in range(count, count + 10):
        store.put(replace(small, key=f"k{i}"), f"i{i}")
    store._connection.set_progress_handler(None, 10)
    return work
