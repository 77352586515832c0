"""``check_solver``: every claim about one solver, as named checks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial

from hhtbench.protocol import Solver
from hhtbench.testing.check import Check, check_expected
from hhtbench.testing.claims import conduct, control, events, failures, frames, motion
from hhtbench.testing.claims.registry import claims_of
from hhtbench.testing.extremes.checks import extreme_checks
from hhtbench.testing.subject import ACCURACY, ITERATIONS, Claims, Subject

CLAIMS = tuple(claim for module in (motion, control, events, frames, conduct, failures) for claim in claims_of(module))


def check_names(suite: str = "claims") -> list[str]:
    """Of all checks of a solver, in their order; ``suite`` as in :func:`check_solver`."""
    return [name for name, _, _ in _suite(suite)]


def _suite(name: str) -> list[tuple[str, str, Callable[[Subject], None]]]:
    """Names, sentences and measurements."""
    if name == "claims":
        return [(check, claim.sentence, measure) for claim in CLAIMS for check, measure in claim.named()]
    if name == "extremes":
        return extreme_checks()
    raise ValueError(f"suite must be claims or extremes; got {name!r}.")


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
    """Every check of ``solver``; none runs before it is called.

    Parameters
    ----------
    solver
        A solver, or a spec: ``"acme_rk4"``, ``"my_solver.py:solver(stages=3)"``.
    expected_failed
        Name of a check -> the reason why it is known to fail.  Such a check fails where it passes.
    suite
        "claims": the checks of the protocol and of what is claimed below.  "extremes": hostile cases, of each axis of
        ``hhtbench study stability`` a few: it arrives within the expected error, or ends early and says so.
    order
        Of the error with prescribed steps, for all of q, v, lam and mu; None: nothing is claimed.
    drift
        Most violation of both constraint levels at any step and row; None: what the error of the run allows.
    accuracy
        Largest error of a run, relative to the size of q or v, over the tolerance it was asked for.
    iterations
        Most iterations of Newton's a step on a smooth motion, where the solver counts them.

    Raises
    ------
    ValueError
        ``expected_failed`` names no check, or gives no reason; there is no such suite.
    """
    expected = check_expected(expected_failed, check_names(suite))
    subject = Subject(solver, Claims(order=order, drift=drift, accuracy=accuracy, iterations=iterations))
    return (
        Check(name, sentence, partial(measure, subject), expected.get(name, "")) for name, sentence, measure in _suite(suite)
    )
