"""``check_solver`` and ``check_problem``: the checks of a solver or problem as named, callable objects."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from unittest import SkipTest

import numpy as np

from hhtbench.api import solve
from hhtbench.catalogue.registry import load_problem
from hhtbench.checks.problem import check
from hhtbench.conformance.entry import Entry, Finding, Kind, Outcome, as_known, outcome_of
from hhtbench.conformance.families.errors import known_motion
from hhtbench.conformance.pairwise import FACTOR, assert_solvers_agree
from hhtbench.conformance.registry import CLAIMS, FAMILIES, checks_of
from hhtbench.conformance.subject import ACCURACY, ITERATIONS, Claims, Subject, expect
from hhtbench.protocol.errors import did_you_mean
from hhtbench.protocol.evidence import Row
from hhtbench.protocol.problem import Problem, Solver

SUITES: Mapping[str, Sequence[Entry]] = {"claims": CLAIMS, "extremes": FAMILIES}
SOLVERS = ("hht", "projected")  # two families: one step of the DAE itself, and the underlying ODE put back
RTOL = 1e-4


@dataclass(frozen=True)
class Check:
    """One claim about one solver or problem; calling it raises ``AssertionError`` if the claim does not hold."""

    name: str  #: "mixed/levels"
    claim: str  #: a sentence
    measure: Callable[[], Finding | Outcome | None]  #: raises AssertionError or SkipTest, or returns how it ended
    expected_failed: str = ""  #: the reason why it is known to fail; then passing is the failure

    def __str__(self) -> str:
        return self.name

    def __call__(self) -> None:
        """Raise AssertionError (fails, or passes unexpectedly) or SkipTest (declined, or fails as expected)."""
        found = self.run()
        if not found.kind.good:
            raise AssertionError(f"{self.name}: {found.message}")
        if found.kind in (Kind.declined, Kind.expected):
            raise SkipTest(f"{found.kind.label}: {found.message}")

    def run(self) -> Outcome:
        """Run the check and return its outcome; no exception but an interruption is raised."""
        return replace(as_known(outcome_of(self.measure), self.expected_failed), id=self.name)


def check_names(suite: str = "claims") -> list[str]:
    """Return the names of all checks of a solver, in their order; ``suite`` as in :func:`check_solver`."""
    return [entry.name(*case) for entry, case in checks_of(_suite(suite))]


def _suite(name: str) -> Sequence[Entry]:
    if name not in SUITES:
        raise ValueError(f"suite must be {' or '.join(SUITES)}; got {name!r}.")
    return SUITES[name]


def check_solver(
    solver: Solver | str,
    expected_failed: Mapping[str, str] | None = None,
    *,
    suite: str = "claims",
    order: float | None = None,
    drift: float | None = None,
    accuracy: float = ACCURACY,
    iterations: float = ITERATIONS,
) -> Iterator[Check]:
    """Yield every check of ``solver``; none runs before it is called.

    Parameters
    ----------
    solver
        A solver, or a spec: ``"acme_rk4"``, ``"my_solver.py:solver(stages=3)"``.
    expected_failed
        Name of a check -> the reason why it is known to fail.  Such a check fails if it passes.  Failures that the registry
        knows need not be named.
    suite
        "claims": checks of the protocol and of the claims given below.  "extremes": some cells of each axis of
        ``hhtbench study stability``: the solver arrives within the expected error, or ends early and says so.
    order
        Order of the error with prescribed steps, for q, v, lam and mu; None: nothing is claimed.
    drift
        Largest violation of both constraint levels at any step and row; None: what the error of the run allows.
    accuracy
        Largest error of a run, relative to the size of q or v, divided by the tolerance.
    iterations
        Largest number of Newton iterations per step on a smooth motion, if the solver counts them.

    Raises
    ------
    ValueError
        ``expected_failed`` names no check, or gives no reason; there is no such suite.
    """
    subject = Subject(solver, Claims(order=order, drift=drift, accuracy=accuracy, iterations=iterations))
    made = [
        Check(entry.name(*case), entry.sentence, partial(entry.run, subject, *case), entry.reason(subject, *case))
        for entry, case in checks_of(_suite(suite))
    ]
    return _with_expected(made, expected_failed)


def assert_solver_converges(solver: Solver | str, order: float | None = None) -> None:
    """Assert that the solver's error converges on every scene that it accepts.

    Parameters
    ----------
    solver
        A solver or a spec.
    order
        If given, prescribed steps are halved: the root mean square errors of q, v, lam and mu over the mesh must fall as
        this power of the step.  Without it, error control is tightened from 1e-3 to 1e-5.

    Raises
    ------
    AssertionError
        The error falls more slowly somewhere, or the solver accepts none of the scenes.
    """
    subject = Subject(solver, Claims(order=order))
    (entry,) = (claim for claim in CLAIMS if claim.id == ("tolerance" if order is None else "order"))
    found = [entry.run(subject, *case) for case in entry.cases()]
    expect(all(x.kind.good for x in found), "; ".join(f"{x.case}: {x.message}" for x in found if not x.kind.good))
    expect(any(x.kind is Kind.right for x in found), f"{subject.name} takes none of the scenes: {found[0].message}")


def check_problem(
    problem: Problem | str,
    expected_failed: Mapping[str, str] | None = None,
    *,
    solvers: Sequence[Solver | str] = SOLVERS,
    rtol: float = RTOL,
) -> Iterator[Check]:
    """Yield every claim of ``hhtbench.check`` as a check of its own, and two about the motion.

    ``hhtbench.check`` is run when this is called, since the claims depend on the problem.

    Parameters
    ----------
    problem
        A Problem or a spec.
    expected_failed
        Name of a check -> the reason why it is known to fail.  Such a check fails if it passes.
    solvers, rtol
        Solvers that must agree on the motion to 100 times ``rtol``.

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
    return _with_expected(made, expected_failed)


def _with_expected(checks: Iterable[Check], expected_failed: Mapping[str, str] | None) -> Iterator[Check]:
    """Apply ``expected_failed`` to the checks; raise if a name is unknown or has no reason."""
    made = {check.name: check for check in checks}
    for name, reason in (expected_failed or {}).items():
        if name not in made:
            hint = did_you_mean(name, made)
            raise ValueError(f"expected_failed: there is no check {name!r}.{hint}")
        if not isinstance(reason, str) or not reason.strip():
            raise ValueError(f"expected_failed: {name} needs a reason, a sentence; got {reason!r}.")
        made[name] = replace(made[name], expected_failed=reason)
    return iter(made.values())


def _row_holds(row: Row) -> None:
    expect(row.passed, f"{row.claim}: {row.measured}; expected {row.bound}")


def _agree(problem: Problem, solvers: tuple[Solver | str, ...], rtol: float) -> None:
    assert_solvers_agree(problem, solvers, rtol, factor=FACTOR)


def _is_known(problem: Problem, solver: Solver | str, rtol: float) -> None:
    known = known_motion(problem, np.linspace(*problem.t_span, 5))
    solution = solve(problem, solver, rtol=rtol, t_eval=known.t)
    expect(solution.success, f"{solution.status.label}: {solution.message}")
    for name in ("q", "v"):
        off = np.abs(getattr(solution, name) - getattr(known, name)) / np.asarray(getattr(problem.scales, name))
        expect(np.max(off, initial=0.0) <= FACTOR * rtol, f"{name} is off what is known by {np.max(off):.1e} of its scale")
