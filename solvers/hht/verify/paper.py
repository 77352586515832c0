"""The list of claims of ``hhtbench verify paper``."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import as_completed
from dataclasses import dataclass

from hhtbench import load_problem
from hhtbench.evidence import Evidence, Plot, Row
from hhtbench.processes import worker_processes
from solvers.hht.verify.constraints import andrews, drift, kinds, multipliers, unconstrained
from solvers.hht.verify.figures import extrapolated, pendulum_figures, test1_figures
from solvers.hht.verify.local import amplification, local_errors, multiplier_guess
from solvers.hht.verify.measure import Case, Progress, known_at, make_case
from solvers.hht.verify.orders import Levels, constant_steps, variable_steps

TEST1 = Levels(constant=(100, 200, 400, 800, 1600), periods=(20, 40, 80, 160), lost=(320, 640, 1280), b=0.3)
PENDULUM = Levels(constant=(250, 500, 1000, 2000), periods=(50, 100, 200, 400), lost=(1000, 2000, 4000), b=0.0)


@dataclass(frozen=True)
class Part:
    """Rows and plots of one part of the verification."""

    rows: tuple[Row, ...]
    plots: tuple[Plot, ...] = ()


def verify_paper(progress: Progress | None = None, jobs: int = 1) -> Evidence:
    """Every claim of the paper that this implementation makes, measured; about two minutes on one core.

    Parameters
    ----------
    progress
        Told what is being measured, a line each (with ``jobs`` above 1: what is finished).
    jobs
        Worker processes.  The rows do not depend on it.
    """
    tell = progress or _nobody
    started = time.perf_counter()
    parts = [part(tell) for part in PARTS] if jobs == 1 else _in_workers(jobs, tell)
    return Evidence(
        title="The paper's claims, reproduced",
        rows=tuple(row for part in parts for row in part.rows),
        plots=tuple(plot for part in parts for plot in part.plots),
        seconds=time.perf_counter() - started,
    )


def _nobody(line: str) -> None:
    """Progress that is not shown."""


def _in_workers(jobs: int, tell: Progress) -> list[Part]:
    """The parts from a pool of processes."""
    with worker_processes(jobs) as pool:
        futures = [pool.submit(part, _nobody) for part in PARTS]
        names = {future: part.__name__.strip("_").replace("_", " ") for future, part in zip(futures, PARTS, strict=True)}
        for future in as_completed(futures):
            tell(f"done: {names[future]}")
        return [future.result() for future in futures]


def _test1() -> Case:
    return make_case("jay_negrut_test1", 1.0, 20)


def _pendulum() -> Case:
    return make_case("jay_negrut_pendulum", 2.0, 25)


def _figures_of_test1(tell: Progress) -> Part:
    rows, plots = test1_figures(_test1(), tell)
    return Part(tuple(rows), tuple(plots))


def _figures_of_the_pendulum(tell: Progress) -> Part:
    case = _pendulum()
    rows, plots = pendulum_figures(case, make_case("jay_negrut_pendulum", 4.0, 25), tell)
    known = (float(known_at(case.problem, name, 2.0)[2]) for name in ("q", "v"))
    rows.append(extrapolated(case, (next(known), next(known)), tell))
    return Part(tuple(rows), tuple(plots))


def _orders_of_test1(tell: Progress) -> Part:
    return Part(tuple(constant_steps(_test1(), TEST1, tell) + variable_steps(_test1(), TEST1, tell)))


def _orders_of_the_pendulum(tell: Progress) -> Part:
    return Part(tuple(constant_steps(_pendulum(), PENDULUM, tell)))


def _variable_steps_of_the_pendulum(tell: Progress) -> Part:
    return Part(tuple(variable_steps(_pendulum(), PENDULUM, tell)))


def _one_step(tell: Progress) -> Part:
    test1, pendulum = _test1(), _pendulum()
    rows = local_errors(test1, tuple(0.004 / 2**k for k in range(5)), tell)
    rows += local_errors(pendulum, tuple(0.002 / 2**k for k in range(5)), tell)
    rows.append(multiplier_guess(test1, (1.0, 0.7, 0.9, 1.1), 0.01))
    rows.append(multiplier_guess(pendulum, (1.0, -1.0, 0.0, 100.0), 0.001))
    return Part(tuple(rows + amplification(tell)))


def _multipliers(tell: Progress) -> Part:
    rows = multipliers(_test1(), [100, 200, 400, 800], tell)
    rows += multipliers(_pendulum(), [500, 1000, 2000, 4000], tell)
    return Part(tuple(rows + drift(_test1(), 400, tell) + drift(_pendulum(), 2000, tell)))


def _other_constraints(tell: Progress) -> Part:
    knife = make_case("knife_edge", 2.0, 20)
    disk = make_case("rolling_disk3d_steady", 2.0, 20)
    rows = kinds(knife, [100, 200, 400, 800], "velocity-level", tell)
    rows += kinds(disk, [1000, 2000, 4000], "mixed", tell)
    rows += unconstrained(make_case("oscillator_chain", 0.5, 20), [2000, 4000, 8000], tell)
    return Part(tuple(rows + drift(knife, 400, tell) + drift(disk, 1000, tell)))


def _andrews(tell: Progress) -> Part:
    rows, held = andrews(load_problem("andrews"), tell)
    return Part(tuple(rows + held))


PARTS: tuple[Callable[[Progress], Part], ...] = (
    _figures_of_test1,
    _figures_of_the_pendulum,
    _orders_of_test1,
    _orders_of_the_pendulum,
    _variable_steps_of_the_pendulum,
    _one_step,
    _multipliers,
    _other_constraints,
    _andrews,
)
