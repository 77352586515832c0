"""Acceptance K2, K8: whatever one cell does to its worker costs that cell only."""

from __future__ import annotations

import os
import re
import resource
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hhtbench.campaign import Campaign, Grid, Limits, execute, machine, process, run_campaign
from hhtbench.campaign import campaign as loop
from hhtbench.campaign.store import Store, load_rows
from hhtbench.protocol.errors import ProblemError
from hhtbench.runtime import processes
from tests.campaign.plugin import alive, first_cells, rows_so_far, started, wait_for

TOLERANCES = (1e-3, 1e-6)  # the solver of the test misbehaves at the second
ENDS = {
    "good": "success",
    "segv": "crashed",
    "exit": "crashed",
    "fork": "crashed",
    "raise": "user_exception",
    "interrupt": "user_exception",
    "memory_error": "out_of_memory",
    "eat": "out_of_memory",
    "hang": "deadline",
    "nan": "unreliable",
    "inf": "unreliable",
    "huge": "unreliable",
    "empty": "unreliable",
    "short": "unreliable",
}
SAID = {
    "segv": "signal SIGSEGV.*misbehave",  # the line, from faulthandler
    "exit": "exit code 7",
    "raise": r"no more.*told\.py",
    "interrupt": r"^KeyboardInterrupt: by the plugin \(raised in told\.py",
    "hang": "the solve did not end within",
    "eat": "GiB",
    "nan": "not finite",
    "short": "the last time is",
    "empty": "there are no rows",
}


def campaign(*does: str, **changes: float) -> Campaign:
    solvers = tuple(f"told(does='{name}')" for name in does)
    return Campaign(grids=(Grid(problems=("fall",), solvers=solvers, rtol=TOLERANCES),), **{"max_seconds": 4.0, **changes})


@pytest.fixture(scope="module")
def limits() -> Limits:
    return Limits(jobs=2, memory=700 * 2**20)


@pytest.mark.parametrize(
    "does", [("good", "segv", "raise", "eat", "hang", "nan", "short"), pytest.param(tuple(ENDS), marks=pytest.mark.long)]
)
def test_a_cell_that_crashes_hangs_raises_or_lies_costs_itself_only(
    does: tuple[str, ...], outside: Path, tmp_path: Path, limits: Limits, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(execute, "GRACE", 0.5)
    asked = campaign(*does, "decline", max_seconds=9.0)  # on a busy machine pages come slowly, which "eat" needs many of
    absent = Grid(problems=("fall",), solvers=("told(size=3)", "absent"), rtol=(1e-3,))
    with Store(tmp_path / "runs.db") as store:
        done = run_campaign(replace(asked, grids=(*asked.grids, absent)), store, limits=limits, timing=False)
    rows = load_rows(tmp_path / "runs.db")
    assert len(rows) == done.cells == done.ran == 2 * len(does) + 4
    found = {(row.solver, row.request["rtol"]): row for row in rows}
    for one in does:
        solver = f"told(does='{one}')"
        assert found[solver, 1e-3].status == "success", one
        assert found[solver, 1e-3].metrics["errors"]["q"]["end"] == pytest.approx(1e-3)
        assert found[solver, 1e-6].status == ENDS[one], found[solver, 1e-6]
    messages = {row.solver[11:-2]: row.message for row in rows if row.request["rtol"] == 1e-6}
    assert {one: SAID[one] for one in SAID if one in does and not re.search(SAID[one], messages[one])} == {}
    assert all(row.environment["sqlite"] for row in rows)
    declined = [row for row in rows if row.status == "declined"]
    assert {row.message.partition(":")[0] for row in declined} == {"it never takes anything", "it cannot be loaded"}
    assert all(row.metrics == {} and row.counters == {} for row in declined)
    with Store(tmp_path / "runs.db") as store:
        again = run_campaign(asked, store, limits=limits, timing=False)
    assert (again.ran, again.cells) == (0, 2 * len(does) + 2)


def test_successes_are_timed_once_for_a_machine_and_a_resumed_campaign_runs_nothing(
    outside: Path, tmp_path: Path, limits: Limits, monkeypatch: pytest.MonkeyPatch
):
    log = tmp_path / "log"
    solver = f"told(seconds=0.01, log='{log}')"
    asked = Campaign(grids=(Grid(problems=("fall",), solvers=(solver, "told(does=segv)"), rtol=TOLERANCES),), repeats=3)
    with Store(tmp_path / "runs.db") as store:
        done = run_campaign(asked, store, limits=limits)
        assert (done.ran, done.timed) == (4, 3)
        solves = len(log.read_text().split())
        again = run_campaign(asked, store, limits=limits)
        assert (again.ran, again.timed) == (0, 0)
    assert len(log.read_text().split()) == solves
    assert solves >= 2 * (3 + 3 * 2)  # each: with rows, without, at every step; three readings of a solve and more
    rows = {(row.solver[:9], row.request["rtol"]): row for row in load_rows(tmp_path / "runs.db")}
    timing = rows["told(log=", 1e-3].timing
    assert timing["repeats"] == 3
    assert 0.0 < timing["best_s"] <= timing["median_s"] < 0.01 < timing["wall_s"]  # it sleeps
    assert timing["disturbed"] is True
    assert rows["told(does", 1e-6].timing == {}
    assert rows["told(log=", 1e-3].counters["steps_accepted"] == 4
    there = {**machine.machine_facts(), "processor": "another", "cores": 99}
    for module in (loop, execute):
        monkeypatch.setattr(module, "machine_facts", lambda: there)
    with Store(tmp_path / "runs.db") as store:
        again = run_campaign(asked, store, limits=limits)
    assert (again.ran, again.timed) == (0, 3)
    for row in load_rows(tmp_path / "runs.db"):
        assert not row.timing or row.timing["machine"]["processor"] == "another"
        assert row.environment["processor"] != "another" and row.environment["cores"] >= 1
        assert re.fullmatch(r"[0-9a-f]{40}(-dirty)?|unknown", row.environment["commit"])


def test_a_larger_budget_repeats_the_cells_that_ran_out_of_time(
    outside: Path, tmp_path: Path, limits: Limits, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(execute, "GRACE", 0.2)
    asked = campaign("hang", max_seconds=0.3)
    one = Limits(jobs=1, memory=limits.memory)
    with Store(tmp_path / "runs.db") as store:
        assert run_campaign(asked, store, limits=one, timing=False).ran == 2
        assert run_campaign(asked, store, limits=one, timing=False).ran == 0
        assert run_campaign(replace(asked, max_seconds=0.4), store, limits=one, timing=False).ran == 1


def test_changed_sources_run_again_and_replace_the_old_row(outside: Path, tmp_path: Path, limits: Limits):
    asked = campaign("good")
    one = Limits(jobs=1, memory=limits.memory)
    with Store(tmp_path / "runs.db") as store:
        run_campaign(asked, store, limits=one, timing=False)
        path = outside / "outside" / "told.py"
        path.write_text(path.read_text() + "\n# changed\n")
        assert run_campaign(asked, store, limits=one, timing=False).ran == 2
    assert {row.key for row in load_rows(tmp_path / "runs.db")} == {cell.key for cell in first_cells(asked)}


def test_a_worker_that_cannot_start_ends_the_campaign(
    outside: Path, tmp_path: Path, limits: Limits, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("hhtbench.runtime.processes.START", "raise SystemExit('no such thing')")
    with Store(tmp_path / "runs.db") as store, pytest.raises(ProblemError, match=r"cannot start.*no such thing"):
        run_campaign(campaign("good"), store, limits=limits, timing=False)


def ends(tmp_path: Path, *solvers: str, **options: Any) -> dict[str, tuple[str, str]]:
    """Status and message at the tighter tolerance, of a campaign by one worker."""
    asked = Campaign(grids=(Grid(problems=("fall",), solvers=solvers, rtol=TOLERANCES),), max_seconds=9.0)
    with Store(tmp_path / "runs.db") as store:
        run_campaign(asked, store, limits=Limits(jobs=1), timing=False, **options)
    rows = [row for row in load_rows(tmp_path / "runs.db") if row.request["rtol"] == 1e-6]
    return {row.solver: (row.status, row.message) for row in rows}


def test_what_a_cell_does_to_its_worker_harms_no_other(outside: Path, tmp_path: Path):
    """Workers killed by somebody are replaced, a crash counts only in a new one, files left open end with theirs."""
    log = tmp_path / "log"
    once, always = f"told(does='killed once', mark='{tmp_path / 'mark'}')", f"told(does='killed', log='{log}')"
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (512, hard))
    try:
        found = ends(tmp_path, once, always, *(f"told(does='{name}')" for name in ("spoil", "fragile", "leak", "files")))
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    status, message = found.pop(always)
    assert status == "crashed"
    assert "SIGKILL" in message and f"{execute.MOST_KILLS} times" in message
    assert len(log.read_text().split()) == 3 + execute.MOST_KILLS  # the looser tolerance: with rows, without, at every step
    assert len(found) == 5 and set(found.values()) == {("success", "there")}


@pytest.mark.long
def test_a_solver_that_writes_two_gigabytes_neither_fails_nor_fills_the_disk(
    outside: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    sizes, receive = [0], process.WorkerProcess.receive

    def looking(worker: process.WorkerProcess) -> dict[str, Any] | None:
        sizes.append(os.fstat(worker._stderr.fileno()).st_size)
        return receive(worker)

    monkeypatch.setattr(process.WorkerProcess, "receive", looking)
    assert ends(tmp_path, "told(does='flood')") == {"told(does='flood')": ("success", "there")}
    assert process.MOST_SAID < max(sizes) < 512 * 2**20 < 256 * 4_000_000  # what the cell writes, three times


@pytest.mark.long
def test_a_solver_that_keeps_memory_is_given_a_fresh_worker_and_finishes(outside: Path, tmp_path: Path):
    """Of 400 MB a solve, three solves a cell, in workers that may use 2 GB: every second cell or so meets the limit."""
    solver = "told(does='hoard')"
    tight = tuple(value * 1e-6 for value in range(1, 5))
    asked = Campaign(grids=(Grid(problems=("fall",), solvers=(solver,), rtol=tight),), max_seconds=9.0)
    with Store(tmp_path / "runs.db") as store:
        run_campaign(asked, store, limits=Limits(jobs=1, memory=2 * 2**30), timing=False)
    assert [row.status for row in load_rows(tmp_path / "runs.db")] == ["success"] * len(tight)


def test_cells_that_ended_with_a_status_run_again_where_that_is_asked(outside: Path, tmp_path: Path):
    mark = tmp_path / "mark"
    solver = f"told(does='abort unless marked', mark='{mark}')"
    assert ends(tmp_path, solver)[solver][0] == "crashed"
    mark.touch()
    assert ends(tmp_path, solver, retry=("out_of_memory",))[solver][0] == "crashed"
    assert ends(tmp_path, solver, retry=("crashed",))[solver] == ("success", "there")


def test_a_worker_that_dies_while_it_starts_or_gets_no_process_is_started_again(
    outside: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    mark, failures = tmp_path / "mark", [OSError("no more processes"), OSError("no more processes")]
    dies = f"import os\nif not os.path.exists({str(mark)!r}):\n open({str(mark)!r}, 'w'); os.kill(os.getpid(), 9)\n"
    monkeypatch.setattr("hhtbench.runtime.processes.START", dies + processes.START)

    def start() -> process.WorkerProcess:
        if failures:
            raise failures.pop()
        return process.WorkerProcess()

    monkeypatch.setattr(execute, "WorkerProcess", start)
    assert ends(tmp_path, "told") == {"told": ("success", "there")}
    assert mark.exists() and not failures


def test_workers_that_cannot_start_any_more_end_the_campaign_while_a_cell_waits_for_a_second_try(
    outside: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    mark = tmp_path / "mark"
    dies = f"import os\nif os.path.exists({str(mark)!r}): raise SystemExit('no more')\n"
    monkeypatch.setattr("hhtbench.runtime.processes.START", dies + processes.START)
    with pytest.raises(ProblemError, match=r"cannot start.*no more"):
        ends(tmp_path, f"told(does='killed once', mark='{mark}')", "told")


def test_rows_of_other_versions_are_refused(outside: Path, tmp_path: Path, limits: Limits, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(execute, "machine_facts", lambda: {**machine.machine_facts(), "numpy": "1.0"})
    with Store(tmp_path / "runs.db") as store, pytest.raises(ProblemError, match=r"has numpy 1\.0, here it is"):
        run_campaign(campaign("good"), store, limits=limits)
    assert load_rows(tmp_path / "runs.db") == []


@pytest.mark.parametrize(
    "number", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.long)], ids=["kill -9", "Ctrl-C"]
)
def test_kill_9_of_the_runner_loses_nothing_acknowledged_and_leaves_no_worker(
    outside: Path, tmp_path: Path, number: signal.Signals
):
    """Nor does Ctrl-C, which says how to go on; other signals, and two of them, in test_run_faults.py."""
    store, log = tmp_path / "runs.db", tmp_path / "log"
    options = ["run", "--store", str(store), "--problems", "fall", "--solvers", f"told(seconds=0.2, log='{log}')"]
    options += ["--no-timing", "--jobs", "1", "--rtol", "1e-3,2e-3,3e-3,4e-3,5e-3"]
    runner = started(outside, *options)
    wait_for(lambda: len(rows_so_far(store)) >= 2)
    os.kill(runner.pid, number)
    _, said = runner.communicate(timeout=20)
    kept = load_rows(store)
    assert 2 <= len(kept) < 5
    if number == signal.SIGINT:
        assert runner.returncode == 130 and "Traceback" not in said
        assert shlex.split(said.strip().splitlines()[-1]) == ["hhtbench", *options]
    wait_for(lambda: not any(alive(int(pid)) for pid in set(log.read_text().split())), 5)
    out, _ = started(outside, *options).communicate(timeout=60)
    assert f"5 cells: 5 success ({5 - len(kept)} run now, 0 timed now)" in out
    rows = load_rows(store)
    assert len(rows) == 5
    assert all(row in rows for row in kept)


HOLDS = """
import sys, time
from hhtbench.campaign.process import WorkerProcess
worker = WorkerProcess()
asked = {"rtol": 1e-6, "outputs": 3, "counting": False, "max_seconds": 9.0, "atol": None, "step": None, "steps": None}
while not worker.ready:
    worker.receive()
worker.submit("a cell", {"problem": "fall", "solver": sys.argv[1], "request": asked, "repeats": 0})
time.sleep(60)
"""


def test_a_worker_that_hangs_in_c_dies_with_its_killed_runner(outside: Path, tmp_path: Path):
    log = tmp_path / "log"
    solver = f"told(does='hang', log='{log}')"
    environment = {**os.environ, "PYTHONPATH": str(outside)}
    runner = subprocess.Popen([sys.executable, "-c", HOLDS, solver], env=environment)
    wait_for(lambda: log.exists() and bool(log.read_text()))
    time.sleep(0.1)  # it hangs now
    os.kill(runner.pid, signal.SIGKILL)
    runner.wait()
    wait_for(lambda: not alive(int(log.read_text())), 5)
