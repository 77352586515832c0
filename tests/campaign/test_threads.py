"""BLAS has one thread in every process that hhtbench starts, unless the user names a number."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
import scipy.linalg  # noqa: F401 - the BLAS libraries that are loaded are counted below

from hhtbench.campaign.process import WorkerProcess
from hhtbench.runtime import processes
from hhtbench.runtime.processes import THREADS, Worker, one_blas_thread, openblas, worker_processes
from tests.campaign.plugin import wait_for

TELLING = """
from pathlib import Path
import scipy.linalg  # with a BLAS of its own, as NumPy has
from hhtbench.runtime.processes import openblas
from outside.fall import problem

THREADS = [get() for get in openblas("get")]
Path(__file__).with_name("told").write_text(str(THREADS))
"""
POOL = """
import os, numpy, scipy.linalg
from hhtbench.catalogue.filespec import load_attribute
from hhtbench.runtime.processes import THREADS, worker_processes

with worker_processes(1) as pool:
    print(pool.submit(load_attribute, {!r}, "THREADS").result(), *set(THREADS) & set(os.environ))
"""
ONE = [1 for _ in openblas("get")]


@pytest.fixture
def telling(tmp_path: Path, outside: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A problem's file that writes down how many threads BLAS has where it is loaded; nobody named a number before."""
    for name in THREADS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PYTHONPATH", str(outside))
    file = tmp_path / "telling.py"
    file.write_text(TELLING)
    return file


def test_a_command_has_one(telling):
    command = [sys.executable, "-c", "from hhtbench.cli.main import main; main()", "describe", f"{telling}:problem"]
    subprocess.run(command, check=True, capture_output=True)
    assert telling.with_name("told").read_text() == str(ONE)


def test_the_worker_of_a_campaign_has_one(telling):
    worker = WorkerProcess()
    worker.submit("a cell", {"problem": f"{telling}:problem", "solver": "absent", "request": {}, "repeats": 0})
    wait_for(lambda: worker.receive() is not None)
    worker.kill()
    assert telling.with_name("told").read_text() == str(ONE)


def test_the_worker_of_a_script_without_a_guard_has_one_and_runs_nothing_of_the_script_which_keeps_its_own(telling):
    script = telling.with_name("script.py")
    script.write_text(POOL.format(str(telling)))
    done = subprocess.run([sys.executable, script], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == str(ONE)


def test_a_call_that_ends_its_process_costs_only_itself_and_an_exception_keeps_its_class():
    with worker_processes(1) as pool:
        calls = [pool.submit(*call) for call in ((os._exit, 7), (int, "x"), (os.getpid,), (os.getpid,))]
        with pytest.raises(EOFError, match="its process ended: exit code 7"):
            calls[0].result()
        with pytest.raises(ValueError, match="invalid literal"):
            calls[1].result()
        assert calls[2].result() == calls[3].result() != os.getpid()
    with worker_processes(1, fresh=True) as pool:
        assert pool.submit(os.getpid).result() != pool.submit(os.getpid).result()


def test_a_call_that_does_not_answer_is_killed_and_the_next_one_has_another_process():
    worker = Worker()
    try:
        with pytest.raises(TimeoutError, match="no answer"):
            worker.call(time.sleep, 60, seconds=0.1)
        assert worker.call(abs, -1) == 1
    finally:
        worker.end()


@pytest.mark.parametrize("chosen", [{"OMP_NUM_THREADS": "2"}, {"OPENBLAS_NUM_THREADS": "4"}, {}])
def test_a_number_that_the_user_names_is_kept(chosen, monkeypatch):
    given = []
    monkeypatch.setattr(processes, "openblas", lambda verb: [given.append])
    monkeypatch.setattr(os, "environ", dict(chosen))
    one_blas_thread()
    assert given == ([] if chosen else [1])
    assert os.environ == (chosen or dict.fromkeys(THREADS, "1"))
