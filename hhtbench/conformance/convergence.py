"""``assert_solver_converges``: the error falls with the step, or with the tolerance, as it should."""

from __future__ import annotations

from hhtbench.conformance.claims.motion import error_falls_with_the_step, error_follows_the_tolerance
from hhtbench.conformance.scenes import SCENES
from hhtbench.conformance.subject import Claims, Declined, Subject
from hhtbench.protocol import Solver


def assert_solver_converges(solver: Solver | str, order: float | None = None) -> None:
    """The solver's error converges on every scene that it takes.

    Parameters
    ----------
    solver
        A solver or a spec.
    order
        With it, prescribed steps are halved: the root mean square errors of q, v, lam and mu over the mesh must fall to
        this power of the step.  Without it, error control is tightened from 1e-3 to 1e-5.

    Raises
    ------
    AssertionError
        The error falls more slowly somewhere, or the solver takes none of the scenes.
    """
    subject = Subject(solver, Claims(order=order))
    measure = error_follows_the_tolerance if order is None else error_falls_with_the_step
    declined, faults = [], []
    for name in SCENES:
        try:
            measure(subject, name)
        except Declined as reason:
            declined.append(str(reason))
        except AssertionError as fault:
            faults.append(f"{name}: {fault}")
    if faults:
        raise AssertionError("; ".join(faults))
    if len(declined) == len(SCENES):
        raise AssertionError(f"{subject.name} takes none of the scenes: {declined[0]}")
