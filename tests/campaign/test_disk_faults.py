"""Acceptance K3, K5, K7: disks that are full, read-only or broken, and power that fails, lose nothing acknowledged.

The whole of it is long, ``make test-faults``.
"""

from __future__ import annotations

import errno
import re
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from random import Random

import pytest

from hhtbench.campaign.store import RunRow, Store, load_rows
from tests.campaign.faulty_disk import after_power_loss, environment, preloaded, read_changes
from tests.campaign.test_store import ROW, fill

WRITES = """
import os, sys
from dataclasses import replace
from hhtbench.protocol.errors import ProblemError
from hhtbench.campaign.store import Store
from hhtbench.campaign.store.sqlite import Entry
from tests.campaign.test_store import ROW

def row(name, seconds):
    return replace(ROW, key=name, message="m" * 6000, timing={"repeats": seconds})

told = os.open(sys.argv[1] + ".told", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
try:
    with Store(sys.argv[1]) as store:
        for i in range(2):
            store.put(row(f"n{i}", None), f"identity n{i}")
            os.write(told, f"n{i} None\\n".encode())
        store.write(Entry(row=row(f"t{i}", None), identity=f"identity t{i}") for i in range(3))
        os.write(told, b"".join(f"t{i} None\\n".encode() for i in range(3)))
        store.write(Entry(row=row(f"t{i}", i), identity=f"identity t{i}", replaces=True) for i in range(3))
        os.write(told, b"".join(f"t{i} {i}\\n".encode() for i in range(3)))
except ProblemError as error:
    print(error)
    sys.exit(2)
"""
STEPS = 5  # every so many changes a disk begins to fail, of each kind of failure at others


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return preloaded(tmp_path_factory.mktemp("faulty"))


def write_rows(path: Path, library: Path, **settings: object) -> subprocess.CompletedProcess[str]:
    """A process that adds five rows, three of them twice, and tells in ``<path>.told`` what is acknowledged."""
    surroundings = environment(library, files=path, **settings)
    return subprocess.run(
        [sys.executable, "-c", WRITES, str(path)], env=surroundings, capture_output=True, text=True, check=False
    )


def acknowledged(told: bytes) -> dict[str, int | None]:
    """Key -> what the newest acknowledged row of it holds in ``timing``."""
    lines = [line.split() for line in told.decode().splitlines()]
    return {key: None if value == "None" else int(value) for key, value in lines}


def wrong(path: Path, told: dict[str, int | None], before: list[RunRow]) -> Counter[str]:
    """What of it a new runner does not find, finds changed, or finds twice."""
    with Store(path):  # as a runner opens it: what is damaged is set aside
        pass
    rows = load_rows(path)
    kept = {row.key: row for row in rows}
    faults = Counter({"doubled": len(rows) - len(kept)})
    faults["lost"] = sum(row.key not in kept for row in before) + sum(key not in kept for key in told)
    faults["changed"] = sum(row.key in kept and kept[row.key] != row for row in before)
    for key, row in kept.items():
        if key[0] in "nt":
            newer = told.get(key) is None and row.timing["repeats"] is not None  # written, not acknowledged
            same = replace(row, timing={}, created="") == replace(ROW, key=key, message="m" * 6000, timing={}, created="")
            faults["changed"] += not same or (key in told and row.timing["repeats"] != told[key] and not newer)
    return +faults


@pytest.mark.long
@pytest.mark.parametrize(
    ("number", "said"),
    [(errno.ENOSPC, "full"), (errno.EIO, "disk I/O error"), (errno.EROFS, "read|unable to open")],  # as SQLite says it
    ids=["full", "broken", "read-only"],
)
def test_a_disk_that_begins_to_fail_at_any_change_loses_nothing_acknowledged(
    tmp_path: Path, library: Path, number: int, said: str
):
    after, found, messages = number % STEPS, Counter[str](), []
    while True:
        path = tmp_path / f"{after}" / "runs.db"
        path.parent.mkdir()
        before = fill(path, 2)
        done = write_rows(path, library, after=after, errno=number)
        told = path.with_name("runs.db.told")
        found += wrong(path, acknowledged(told.read_bytes() if told.exists() else b""), before)
        if done.returncode == 0:
            break
        assert done.returncode == 2 and "Traceback" not in done.stderr, (after, done)
        messages.append(done.stdout)
        after += STEPS
    assert found == {}
    assert after > 30, "the failures were not where the rows are written"
    assert all(str(path.name) in message for message in messages)
    assert any(re.search(said, message) for message in messages)


def losses(tmp_path: Path, library: Path, ways: int, every: int) -> tuple[Counter[str], int]:
    """What is wrong after a power failure at every ``every``-th change, and how many were tried."""
    path, log = tmp_path / "written" / "runs.db", tmp_path / "log"
    path.parent.mkdir()
    assert write_rows(path, library, log=log).returncode == 0
    changes, found, tried = read_changes(log), Counter[str](), 0
    for cut in range(0, len(changes) + 1, every):
        told = b"".join(change.data for change in changes[:cut] if change.name == ".told" and change.what == "w")
        for way in range(ways):
            files = after_power_loss(changes[:cut], Random(f"{cut} {way}") if way else None)
            again = tmp_path / f"{cut}.{way}" / "runs.db"
            again.parent.mkdir()
            for name, content in files.items():
                if name != ".told":
                    again.with_name(f"runs.db{name}").write_bytes(content)
            found += wrong(again, acknowledged(told), [])
            tried += 1
    return found, tried


def test_power_that_fails_now_and_then_loses_nothing_acknowledged(tmp_path: Path, library: Path):
    found, tried = losses(tmp_path, library, ways=1, every=1)
    assert found == {}
    assert tried > 50


@pytest.mark.long
def test_power_that_fails_at_any_change_loses_nothing_acknowledged_whatever_of_the_rest_came_through(
    tmp_path: Path, library: Path
):
    found, tried = losses(tmp_path, library, ways=6, every=1)
    assert found == {}
    assert tried > 300


@pytest.mark.long
def test_a_read_only_folder_is_told_and_its_store_can_be_read(tmp_path: Path, library: Path):
    path = tmp_path / "runs.db"
    rows = fill(path, 2)
    path.with_name("runs.db.lock").unlink()
    done = write_rows(path, library, after=0, errno=errno.EROFS)
    assert done.returncode != 0 and "Read-only file system" in done.stdout + done.stderr
    reads = f"import sys; from hhtbench.campaign.store import load_rows; print(len(load_rows({str(path)!r})))"
    surroundings = environment(library, files=path, after=0, errno=errno.EROFS)
    read = subprocess.run([sys.executable, "-c", reads], env=surroundings, capture_output=True, text=True, check=True)
    assert read.stdout == "2\n"
    assert load_rows(path) == rows
