"""What a campaign costs beside its solves: ``python -m tests.performance.campaign_overhead [--cells 10000] [--jobs 2]``.

Two campaigns into stores of their own, in worker processes as ever.  One of synthetic cells, whose solves take no time: its
wall time over the number of cells is the overhead of a cell, measurement, pipe and disk included.  One of real solvers: the
time that workers wait between a result and the next task, and the processor time of the runner, over the time of the tasks.
The exit code is 1 where a limit is broken; on a machine that does other work too, look at the processor times.
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from hhtbench.campaign import Campaign, Grid, run_campaign
from hhtbench.campaign.execute import machine_limits
from hhtbench.campaign.process import WorkerProcess
from hhtbench.campaign.store import Store

LIMIT_CELL = 5.0  # ms
LIMIT_SHARE = 0.05
PAIRS = 20

SYNTHETIC = """\
import numpy as np
from hhtbench import Counters, Motion, NumpySystem, Problem, Solution, Status

def exact(t):
    return Motion(np.array([1.0 + t]), np.array([1.0]), np.zeros(0), np.zeros(0))

def problem(kind=0):
    system = NumpySystem(force=lambda t, q, v: 0 * q)
    return Problem(name="line", system=system, t_span=(0.0, 1.0), q0=[1.0], v0=[1.0], exact=exact)

class Line:
    name = "line"

    def __init__(self, kind=0):
        self.kind = kind

    def accepts(self, problem, request):
        return None

    def solve(self, problem, request):
        t = np.linspace(0.0, 1.0, 5) if request.t_eval is None else request.t_eval
        none = np.zeros((t.size, 0))
        return Solution(t=t, q=1.0 + t[:, None], v=np.ones((t.size, 1)), lam=none, mu=none, status=Status.success,
                        message="there", counters=Counters(steps_accepted=4))
"""


@dataclass
class Clock:
    """When the workers had work."""

    first: float = float("inf")  #: the first task went out [s]
    busy: float = 0.0  #: time of all tasks together [s]
    waits: float = 0.0  #: time of all workers between two tasks [s]
    since: dict[int, float] = field(default_factory=dict)  #: by worker: when its task or its wait began


@contextmanager
def watched() -> Iterator[Clock]:
    """Every task that goes to a worker meanwhile is timed, in the runner."""
    clock, submit, receive = Clock(), WorkerProcess.submit, WorkerProcess.receive

    def timed_submit(worker: WorkerProcess, task: Any, message: Any) -> None:
        now = time.perf_counter()
        clock.first = min(clock.first, now)
        clock.waits += now - clock.since.get(id(worker), now)
        clock.since[id(worker)] = now
        submit(worker, task, message)

    def timed_receive(worker: WorkerProcess) -> Any:
        result = receive(worker)
        if result is not None:
            now = time.perf_counter()
            clock.busy += now - clock.since[id(worker)]
            clock.since[id(worker)] = now
        return result

    with patch.object(WorkerProcess, "submit", timed_submit), patch.object(WorkerProcess, "receive", timed_receive):
        yield clock


def synthetic(count: int, folder: Path) -> Campaign:
    """``count`` cells, of ``PAIRS`` pairs at different tolerances."""
    file = folder / "synthetic.py"
    file.write_text(SYNTHETIC)
    solvers = tuple(f"{file}:Line(kind={kind})" for kind in range(PAIRS))
    rtol = tuple(float(value) for value in np.geomspace(1e-8, 1e-2, count // PAIRS))
    return Campaign(grids=(Grid(problems=(f"{file}:problem",), solvers=solvers, rtol=rtol),))


def real() -> Campaign:
    """Three problems by four solvers."""
    problems = ("jay_negrut_pendulum", "andrews", "oscillator_chain")
    solvers = ("ida(form=ggl)", "cvode(form=ode, method=bdf)", "scipy(method=Radau)", "hht(alpha=-0.05)")
    return Campaign(grids=(Grid(problems=problems, solvers=solvers, rtol=(1e-3, 1e-4, 1e-5, 1e-6)),))


def measure(name: str, campaign: Campaign, jobs: int, folder: Path) -> tuple[float, float]:
    """Milliseconds of wall time a cell, and the harness' share of the tasks' time; both are printed."""
    with Store(folder / f"{name}.sqlite") as store, watched() as clock:
        begun, cpu, children = time.perf_counter(), time.process_time(), processor_time_of_children()
        done = run_campaign(campaign, store, limits=machine_limits(jobs), timing=False)
        ended, cpu = time.perf_counter(), time.process_time() - cpu
        children = processor_time_of_children() - children
    per_cell = 1e3 * (ended - clock.first) / done.ran
    share = (clock.waits + cpu) / clock.busy
    runner, workers = 1e3 * cpu / done.ran, 1e3 * children / done.ran
    lines = (
        f"{name}: {done.ran} cells in {ended - begun:.1f} s by {jobs} workers",
        f"from the first task on {per_cell:.2f} ms a cell",
        f"processor time of a cell: runner {runner:.2f} ms, workers with their start {workers:.2f} ms",
        f"tasks took {1e3 * clock.busy / done.ran:.2f} ms each, waits between tasks {1e3 * clock.waits / done.ran:.3f} ms",
        f"waits and runner are {100 * share:.1f} % of the tasks' time",
    )
    print("\n    ".join(lines))  # noqa: T201
    return per_cell, share


def processor_time_of_children() -> float:
    """Of the workers that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--cells", type=int, default=10_000)
    parser.add_argument("--jobs", type=int, default=2)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        per_cell, _ = measure("synthetic", synthetic(chosen.cells, folder), chosen.jobs, folder)
        _, share = measure("real", real(), chosen.jobs, folder)
    sys.exit(0 if per_cell < LIMIT_CELL and share < LIMIT_SHARE else 1)


if __name__ == "__main__":
    main()
