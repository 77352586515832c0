"""``check_problem``: what a problem promises, and that solvers agree on its motion, as named checks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from hhtbench.api import solve
from hhtbench.checks.problem import check
from hhtbench.evidence import Row
from hhtbench.protocol import Problem, Solver
from hhtbench.registry import load_problem
from hhtbench.testing.check import Check, check_expected
from hhtbench.testing.pairwise import assert_solvers_agree
from hhtbench.testing.subject import expect

SOLVERS = ("hht", "projected")  # two families: one step of the DAE itself, and the underlying ODE put back
RTOL = 1e-4
FACTOR = 100.0  # of the tolerance


def check_problem(
    problem: Problem | str,
    expected_failed: Mapping[str, str] | None = None,
    *,
    solvers: Sequence[Solver | str] = SOLVERS,
    rtol: float = RTOL,
) -> Iterator[Check]:
    """Every claim of ``hhtbench.check`` as a check of its own, and two about the motion.

    What ``hhtbench.check`` measures is measured when this is called: which claims there are depends on the problem.

    Parameters
    ----------
    problem
        A Problem or a spec.
    expected_failed
        Name of a check -> the reason why it is known to fail.  Such a check fails where it passes.
    solvers, rtol
        Who must agree on the motion, to 100 times which tolerance.

    Raises
    ------
    ValueError
        ``expected_failed`` names no check, or gives no reason.
    """
    loaded = load_problem(problem)
    rows = [row for row in check(loaded).rows if row.passed is not None]
    made = [Check(row.id, row.claim, partial(_row_holds, row)) for row in rows]
    made.append(Check("motion/agree", "two families agree on the motion", partial(_agree, loaded, tuple(solvers), rtol)))
    if loaded.exact is not None or loaded.reference is not None:
        text = "the motion is that of the closed solution, or of the reference"
        made.append(Check("motion/known", text, partial(_is_known, loaded, solvers[0], rtol)))
    expected = check_expected(expected_failed, [entry.name for entry in made])
    return (Check(entry.name, entry.claim, entry.measure, expected.get(entry.name, "")) for entry in made)


def _row_holds(row: Row) -> None:
    expect(row.passed, f"{row.claim}: {row.measured}; expected {row.bound}")


def _agree(problem: Problem, solvers: tuple[Solver | str, ...], rtol: float) -> None:
    assert_solvers_agree(problem, solvers, rtol, factor=FACTOR)


def _is_known(problem: Problem, solver: Solver | str, rtol: float) -> None:
    t0, t1 = problem.t_span
    if problem.reference is not None:
        times = np.asarray(problem.reference["t"], dtype=float)
        known = {name: np.asarray(problem.reference[name], dtype=float) for name in ("q", "v") if name in problem.reference}
    else:
        times = np.linspace(t0, t1, 5)
        motions = [problem.exact(float(t)) for t in times] if problem.exact is not None else []
        known = {name: np.array([getattr(motion, name) for motion in motions]) for name in ("q", "v")}
    inside = (times >= min(t0, t1)) & (times <= max(t0, t1))
    solution = solve(problem, solver, rtol=rtol, t_eval=times[inside])
    expect(solution.success, f"{solution.status.label}: {solution.message}")
    for name, values in known.items():
        off = np.abs(getattr(solution, name) - values[inside]) / np.asarray(getattr(problem.scales, name))
        expect(np.max(off, initial=0.0) <= FACTOR * rtol, f"{name} is off what is known by {np.max(off):.1e} of its scale")
