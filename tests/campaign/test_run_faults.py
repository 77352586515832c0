"""Acceptance K1 to K4, K6: whole runs under faults end with the rows of a run that nobody disturbed (``make test-faults``).

Times differ, as they do from run to run.  Every run is started again with the same command until it is done.
"""

from __future__ import annotations

import errno
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from hhtbench.campaign.store import RunRow, load_rows
from tests.campaign.faulty_disk import environment, preloaded
from tests.campaign.plugin import FILES, GROUPS, alive, rows_so_far, wait_for
from tests.platform.plugins_fixture import make_distribution

pytestmark = pytest.mark.long

KILLS = 50
SHARES = {"worker": 0.6, "runner": 0.25, "group": 0.15}  # of the kills; a group is the runner with all it has started
PAUSES = (0.1, 3.0)  # s between two of them
SOLVERS = "told(seconds=0.1), told(does=segv), told(does='raise'), hht, ida(form=ggl)"
RTOL = [f"{mantissa}e-3" for mantissa in range(1, 9)] + ["1e-6"]
PATIENCE = 60.0  # s until something must have happened


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The distribution from outside."""
    return make_distribution(tmp_path_factory.mktemp("site"), "outside", FILES, GROUPS)


class Campaign:
    """A command, its store, and what of the rows was seen there."""

    def __init__(self, folder: Path, store: Path, solvers: str = SOLVERS, *options: str) -> None:
        self.folder, self.store = folder, store
        self.seen: dict[str, RunRow] = {}
        self.lost = 0
        self.options = ["run", "--store", str(store), "--problems", "fall, simple_pendulum", "--solvers", solvers]
        self.options += ["--rtol", ",".join(RTOL), "--jobs", "2", "--max-seconds", "20", *options]

    def start(self, **variables: str) -> subprocess.Popen[str]:
        """The runner, in a group of its own."""
        command = [sys.executable, "-c", "from hhtbench.cli.main import main; main()", *self.options]
        surroundings = {**os.environ, "PYTHONPATH": str(self.folder), **variables}
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        return subprocess.Popen(command, env=surroundings, text=True, start_new_session=True, **pipes)  # type: ignore[call-overload,no-any-return]

    def run(self, **variables: str) -> tuple[int, str]:
        """To the end: exit code and what it said."""
        runner = self.start(**variables)
        out, err = runner.communicate(timeout=300)
        self.look()
        return runner.returncode, out + err

    def look(self) -> None:
        """At the rows that are there: none that was there is gone or another."""
        now = {row.key: row for row in rows_so_far(self.store)}
        self.lost += sum(key not in now or result(now[key]) != result(row) for key, row in self.seen.items())
        self.seen = now

    def faults(self, expected: dict[str, dict[str, Any]]) -> Counter[str]:
        """What of ``expected`` is not there, there twice or otherwise, and what was there and is not."""
        rows = load_rows(self.store)
        found = {row.key: result(row) for row in rows}
        return +Counter(
            {
                "lost": self.lost,
                "doubled": len(rows) - len(found),
                "missing": len(expected.keys() - found.keys()),
                "different": sum(found.get(key, row) != row for key, row in expected.items()),
                "too many": len(found.keys() - expected.keys()),
            }
        )


def result(row: RunRow) -> dict[str, Any]:
    """A row without what differs from run to run."""
    values = dict(vars(row))
    for name in ("timing", "environment", "created"):
        del values[name]
    return values


@pytest.fixture(scope="module")
def expected(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """The rows of a run that nobody disturbs."""
    calm = Campaign(folder, tmp_path_factory.mktemp("calm") / "runs.sqlite")
    code, said = calm.run()
    assert code == 0, said
    return {row.key: result(row) for row in load_rows(calm.store)}


def workers_of(runner: int) -> list[int]:
    """Worker processes of a runner, from the system's table."""
    found = []
    for entry in Path("/proc").iterdir():
        with suppress(OSError, ValueError, IndexError):
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == runner and "hhtbench.campaign.worker" in (entry / "cmdline").read_text():
                found.append(int(entry.name))
    return found


def kill(runner: int, whom: str, chance: random.Random) -> bool:
    """Whether there was somebody to kill."""
    if whom == "worker":
        workers = workers_of(runner)
        if workers:
            os.kill(chance.choice(workers), signal.SIGKILL)
        return bool(workers)
    workers = workers_of(runner)
    (os.killpg if whom == "group" else os.kill)(runner, signal.SIGKILL)
    if whom == "group":
        for worker in workers:
            with suppress(ProcessLookupError):
                os.killpg(worker, signal.SIGKILL)
    return True


def disturb(campaign: Campaign, most: int, chance: random.Random) -> Counter[str]:
    """Run the campaign to its end with up to ``most`` kills."""
    kills: Counter[str] = Counter()
    runner = campaign.start()
    due, whom = time.monotonic() + chance.uniform(*PAUSES), "worker"
    while (code := runner.poll()) is None or code == -signal.SIGKILL:
        if code is not None:
            runner.communicate()
            campaign.look()
            runner = campaign.start()
        if time.monotonic() > due and kills.total() < most:
            with suppress(ProcessLookupError):
                if kill(runner.pid, whom, chance):
                    kills[whom] += 1
                    due = time.monotonic() + chance.uniform(*PAUSES)
                    whom = chance.choices(list(SHARES), list(SHARES.values()))[0]
        time.sleep(0.01)
    _, said = runner.communicate()
    campaign.look()
    assert code == 0, said
    return kills


def test_fifty_kills_of_runners_their_groups_and_workers_lose_double_and_change_nothing(
    folder: Path, expected: dict[str, dict[str, Any]], tmp_path: Path
):
    chance, kills, faults = random.Random(1), Counter[str](), Counter[str]()
    while kills.total() < KILLS:
        campaign = Campaign(folder, tmp_path / f"{kills.total()}.sqlite")
        kills += disturb(campaign, KILLS - kills.total(), chance)
        faults += campaign.faults(expected)
    assert faults == {}, kills
    assert kills.keys() == SHARES.keys()


def some_rows(campaign: Campaign, count: int) -> bool:
    campaign.look()
    return len(campaign.seen) >= count


@pytest.mark.parametrize("numbers", [("SIGINT",), ("SIGTERM",), ("SIGHUP",), ("SIGINT", "SIGINT"), ("SIGTERM", "SIGINT")])
def test_signals_end_a_run_in_order_and_the_same_command_goes_on(
    folder: Path, expected: dict[str, dict[str, Any]], tmp_path: Path, numbers: tuple[str, ...]
):
    campaign = Campaign(folder, tmp_path / "runs.sqlite")
    runner = campaign.start()
    wait_for(lambda: some_rows(campaign, 5))
    workers = workers_of(runner.pid)
    for name in numbers:
        with suppress(ProcessLookupError):
            runner.send_signal(signal.Signals[name])
    _, said = runner.communicate(timeout=PATIENCE)
    assert runner.returncode in {128 + signal.Signals[name] for name in numbers}
    assert "Traceback" not in said and said.strip().splitlines()[-1].startswith("hhtbench run --store")
    wait_for(lambda: not any(map(alive, workers)))
    assert campaign.run()[0] == 0
    assert campaign.faults(expected) == {}


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return preloaded(tmp_path_factory.mktemp("faulty"))


@pytest.mark.parametrize(("number", "after"), [(errno.ENOSPC, 60), (errno.ENOSPC, 201), (errno.EIO, 152), (errno.EROFS, 3)])
def test_a_run_whose_disk_fails_says_so_and_the_same_command_goes_on_once_it_works(
    folder: Path, expected: dict[str, dict[str, Any]], tmp_path: Path, library: Path, number: int, after: int
):
    campaign = Campaign(folder, tmp_path / "runs.sqlite")
    preload = environment(library, files=campaign.store, after=after, errno=number)
    code, said = campaign.run(**{name: value for name, value in preload.items() if name.startswith(("LD_", "FAULTY_"))})
    assert code == 2 and "Traceback" not in said, said
    assert "runs.sqlite" in said and ("cannot be written" in said or "cannot be opened" in said), said
    assert campaign.run()[0] == 0
    assert campaign.faults(expected) == {}


def test_a_clock_that_is_set_back_an_hour_and_forward_two_changes_nothing(
    folder: Path, expected: dict[str, dict[str, Any]], tmp_path: Path, library: Path
):
    campaign = Campaign(folder, tmp_path / "runs.sqlite")
    preload = environment(library, clock="2:-3600 5:7200 8:-3600")
    code, said = campaign.run(**{name: value for name, value in preload.items() if name.startswith(("LD_", "FAULTY_"))})
    assert code == 0, said
    assert campaign.faults(expected) == {}
    code, said = campaign.run()
    assert code == 0 and "(0 run now, 0 timed now)" in said


def test_of_two_runners_of_one_store_the_second_is_refused_and_one_that_is_gone_is_not_waited_for(
    folder: Path, expected: dict[str, dict[str, Any]], tmp_path: Path
):
    campaign = Campaign(folder, tmp_path / "runs.sqlite")
    runner = campaign.start()
    wait_for(lambda: some_rows(campaign, 1))
    for _ in range(3):
        code, said = Campaign(folder, campaign.store).run()
        assert code == 2 and "another `hhtbench run` writes" in said
    runner.kill()
    runner.communicate()
    lock = campaign.store.with_name("runs.sqlite.lock")
    lock.write_text(f"{os.getpid()}\n")  # as of a process whose number somebody has now
    assert campaign.run()[0] == 0
    assert campaign.faults(expected) == {}


def test_cells_of_a_damaged_store_run_again_and_are_named(folder: Path, expected: dict[str, dict[str, Any]], tmp_path: Path):
    spoilt = Campaign(folder, tmp_path / "runs.sqlite")
    runner = spoilt.start()
    wait_for(lambda: some_rows(spoilt, 30))
    os.kill(runner.pid, signal.SIGKILL)
    runner.communicate()
    spoilt.look()
    content = bytearray(spoilt.store.read_bytes())
    chance = random.Random(2)
    for _ in range(20):
        content[chance.randrange(8192, len(content))] ^= 1 << chance.randrange(8)
    spoilt.store.write_bytes(content)
    spoilt.seen = {}  # what of them is damaged may go
    code, said = spoilt.run()
    assert code == 0, said
    assert "the file was damaged" in said and "cannot be read" in said
    assert spoilt.faults(expected) == {}
