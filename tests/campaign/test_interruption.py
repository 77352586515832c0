"""Ctrl-C and SIGTERM, whenever they come: the exit code of shells, the command that resumes, no process left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from hhtbench.runtime.interruption import Interrupted, ends_in_order
from tests.campaign.plugin import alive, started, wait_for

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


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="children are read from /proc")
def test_studies_end_at_once_with_all_their_processes(outside: Path):
    """They waited for all that was left to do, twenty minutes."""
    runner = started(outside, "study", "stability", "--only", "long_run")
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
        "from hhtbench.runtime.interruption import ends_in_order\n"
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
