"""Ctrl-C and SIGTERM, whenever they come: the exit code of shells, the command that resumes, no process left behind."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from hhtbench.errors import ProblemError
from hhtbench.interruption import Interrupted, ends_in_order
from hhtbench.store import load_rows
from tests.campaign.test_execute import alive

MAIN = "from hhtbench.cli import main; main()"
SWALLOWS = """
    '''A library that catches whatever is raised while it is imported, and takes long for it.'''
    import pathlib, time
    pathlib.Path(__file__).with_name("begun").touch()
    for _ in range(200):
        try:
            time.sleep(0.05)
        except BaseException:
            pass
    def problem(): pass
"""


def started(outside: Path, *options: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(outside)}
    command = [sys.executable, "-c", MAIN, *options]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for(what: Callable[[], bool]) -> None:
    end = time.monotonic() + 60
    while not what():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_a_campaign_that_is_interrupted_says_how_to_go_on_and_that_does(outside: Path, tmp_path: Path):
    """By Ctrl-C; other signals, and two of them, in test_run_faults.py."""
    store, log = tmp_path / "runs.db", tmp_path / "log"
    solver = f"told(seconds=0.2, log='{log}')"
    options = ["run", "--store", str(store), "--problems", "fall", "--solvers", solver, "--no-timing", "--jobs", "1"]
    options += ["--rtol", "1e-3,2e-3,3e-3,4e-3,5e-3"]
    runner = started(outside, *options)
    wait_for(lambda: _count(store) >= 2)
    os.kill(runner.pid, signal.SIGINT)
    _, said = runner.communicate(timeout=20)
    assert runner.returncode == 130
    assert "Traceback" not in said
    command = said.strip().splitlines()[-1]
    assert shlex.split(command) == ["hhtbench", *options]
    assert not any(alive(int(pid)) for pid in set(log.read_text().split()))
    kept = load_rows(store)
    assert 2 <= len(kept) < 5
    again = started(outside, *shlex.split(command)[1:])
    out, _ = again.communicate(timeout=60)
    assert f"5 cells: 5 success ({5 - len(kept)} run now" in out


def _count(store: Path) -> int:
    try:
        return len(load_rows(store))
    except ProblemError:
        return 0


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="children are read from /proc")
@pytest.mark.parametrize("command", ["study stability --only long_run", "verify control --jobs 2"])
def test_studies_end_at_once_with_all_their_processes(command: str, outside: Path):
    """They waited for all that was left to do, twenty minutes."""
    runner = started(outside, *command.split())
    own = Path(f"/proc/{runner.pid}")
    children = lambda: {int(x) for task in own.glob("task/*/children") for x in task.read_text().split()}  # noqa: E731
    wait_for(lambda: len(children()) >= 2)
    time.sleep(1.0)
    workers = children()
    os.kill(runner.pid, signal.SIGTERM)
    _, said = runner.communicate(timeout=10)
    assert runner.returncode == 143
    assert "Traceback" not in said
    wait_for(lambda: not any(alive(pid) for pid in workers))


def test_ctrl_c_ends_a_command_in_the_midst_of_an_import_that_catches_everything(outside: Path, tmp_path: Path):
    begun = slow(outside, "solvers")
    runner = started(outside, "run", *RUN, "--store", str(tmp_path / "runs.db"))
    wait_for(begun.exists)
    os.kill(runner.pid, signal.SIGINT)
    _, said = runner.communicate(timeout=5)
    assert runner.returncode == 130
    assert "Traceback" not in said and "hhtbench run --problems fall" in said


def test_a_second_ctrl_c_ends_any_command_there(outside: Path):
    begun = slow(outside, "problems")
    runner = started(outside, "describe", "slow")
    wait_for(begun.exists)
    for _ in range(2):
        os.kill(runner.pid, signal.SIGINT)
        time.sleep(0.2)
    runner.communicate(timeout=5)
    assert runner.returncode == 130


RUN = ["--problems", "fall", "--solvers", "slow", "--rtol", "1e-3"]


def slow(outside: Path, kind: str) -> Path:
    """Register a module that takes ten seconds to import; the file that says it has begun to."""
    (outside / "outside" / "slow.py").write_text(textwrap.dedent(SWALLOWS))
    points = outside / "outside-1.0.dist-info" / "entry_points.txt"
    points.write_text(points.read_text() + f"[hhtbench.{kind}]\nslow = outside.slow:problem\n")
    return outside / "outside" / "begun"


def test_the_second_signal_ends_a_process_whose_clearing_up_takes_too_long():
    code = (
        "import os, signal, time\n"
        "from hhtbench.interruption import ends_in_order\n"
        "with ends_in_order('so it goes on'):\n"
        "    try:\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "    finally:\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "        time.sleep(60)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 130
    assert "so it goes on" in done.stderr


def test_signals_go_where_they_went_before():
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    with pytest.raises(Interrupted) as caught, ends_in_order():
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1)
    assert caught.value.code == 143
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before
