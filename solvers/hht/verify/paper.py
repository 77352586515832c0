"""The list of claims of ``hhtbench verify paper``."""

from __future__ import annotations

import time

from hhtbench import load_problem
from hhtbench.evidence import Evidence, Row
from solvers.hht.verify.constraints import andrews, drift, kinds, multipliers, unconstrained
from solvers.hht.verify.figures import extrapolated, pendulum_figures, test1_figures
from solvers.hht.verify.local import amplification, local_errors, multiplier_guess
from solvers.hht.verify.measure import Case, Progress, make_case
from solvers.hht.verify.orders import Levels, constant_steps, variable_steps

TEST1 = Levels(constant=(100, 200, 400, 800, 1600, 3200), periods=(20, 40, 80, 160), lost=(320, 640, 1280), b=0.3)
PENDULUM = Levels(constant=(250, 500, 1000, 2000, 4000), periods=(50, 100, 200, 400), lost=(1000, 2000, 4000), b=0.0)


def verify_paper(progress: Progress | None = None) -> Evidence:
    """Every claim of the paper that this implementation makes, measured; about two minutes on one core.

    Parameters
    ----------
    progress
        Told what is being measured, a line each.
    """
    tell = progress or (lambda line: None)
    started = time.perf_counter()
    test1 = make_case("jay_negrut_test1", 1.0, 20)
    pendulum = make_case("jay_negrut_pendulum", 2.0, 25)
    long_pendulum = make_case("jay_negrut_pendulum", 4.0, 25)
    rows1, plots1 = test1_figures(test1, tell)
    rows2, plots2 = pendulum_figures(pendulum, long_pendulum, tell)
    rows: list[Row] = [*rows1, *rows2]
    reference = pendulum.problem.reference
    rows.append(extrapolated(pendulum, (reference["q"][0][2], reference["v"][0][2]), tell))  # type: ignore[index]
    for case, levels in ((test1, TEST1), (pendulum, PENDULUM)):
        rows += constant_steps(case, levels, tell)
        rows += variable_steps(case, levels, tell)
    rows += local_errors(test1, tuple(0.004 / 2**k for k in range(5)), tell)
    rows += local_errors(pendulum, tuple(0.002 / 2**k for k in range(5)), tell)
    rows.append(multiplier_guess(test1, (1.0, 0.3, 3.0, 30.0), 0.01))
    rows.append(multiplier_guess(pendulum, (1.0, -1.0, 0.0, 100.0), 0.001))
    rows += _constraints(test1, pendulum, tell)
    rows += amplification(tell)
    return Evidence(
        title="The paper's claims, reproduced",
        rows=tuple(rows),
        plots=(*plots1, *plots2),
        seconds=time.perf_counter() - started,
    )


def _constraints(test1: Case, pendulum: Case, tell: Progress) -> list[Row]:
    knife = make_case("knife_edge", 2.0, 20)
    disk = make_case("rolling_disk3d_steady", 2.0, 20)
    chain = make_case("oscillator_chain", 0.5, 20)
    rows = multipliers(test1, [100, 200, 400, 800], tell)
    rows += multipliers(pendulum, [500, 1000, 2000, 4000], tell)
    rows += kinds(knife, [100, 200, 400, 800], "velocity-level", tell)
    rows += kinds(disk, [1000, 2000, 4000], "mixed", tell)
    rows += unconstrained(chain, [2000, 4000, 8000], tell)
    andrews_rows, andrews_drift = andrews(load_problem("andrews"), tell)
    rows += andrews_rows
    for case, steps in ((test1, 400), (pendulum, 2000), (knife, 400), (disk, 1000)):
        rows += drift(case, steps, tell)
    return rows + andrews_drift
