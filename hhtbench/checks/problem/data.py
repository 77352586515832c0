"""Check the data that a problem adds to its system: guesses, observables, solutions and measured quantities."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hhtbench.checks.problem.rows import attempt, yes_or_fault
from hhtbench.checks.problem.scales import Sizes
from hhtbench.checks.problem.start import Start
from hhtbench.lowering import CONSISTENT
from hhtbench.protocol.arguments import real_values
from hhtbench.protocol.evidence import Row
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import declared


def data_rows(problem: Problem, m: int | None, p: int | None, sizes: Sizes, start: Start | None) -> list[Row]:
    """Return rows: guesses fit, observables and measured quantities are finite, known solutions begin at the start."""
    rows = []
    for name, size in (("lam_guess", m), ("mu_guess", p)):
        guess = getattr(problem, name)
        if guess is not None and size is not None:
            fault = "" if guess.size == size else f"got shape {guess.shape}"
            rows.append(yes_or_fault(f"data/{name}", f"{name} has one entry per constraint", fault, "fits", f"({size},)"))
    rows += [_observable_row(problem, name, m or 0, start) for name in problem.observables]
    if problem.exact is not None:
        exact = problem.exact
        start_of = lambda: (exact(problem.t_span[0]).q, exact(problem.t_span[0]).v)  # noqa: E731
        claim = "the exact solution begins at q0, v0"
        rows.append(_solution_row("data/exact", claim, problem, sizes, start_of, CONSISTENT))
    if problem.reference is not None:
        rows.append(_reference_row(problem, sizes))
    return rows


def measured_rows(problem: Problem, faults: dict[str, str]) -> list[Row]:
    """Return rows: energy and invariants are finite at the start."""
    rows = []
    for name in ("energy", "invariants"):
        if declared(problem.system, name) is None or name in faults:
            continue
        outcome = attempt(lambda name=name: _measured(problem, name))  # type: ignore[misc]
        wrong = outcome.fault or ", ".join(f"{key} = {x}" for key, x in outcome.value.items() if not np.isfinite(x))
        good = "" if outcome.fault else ", ".join(f"{key} = {x:.6g}" for key, x in outcome.value.items())
        rows.append(yes_or_fault(f"data/{name}", f"{name} is finite at the start", wrong, good, "finite"))
    return rows


def _measured(problem: Problem, name: str) -> dict[str, float]:
    value = declared(problem.system, name)(problem.t_span[0], _copy(problem.q0), _copy(problem.v0))
    values = value if isinstance(value, dict) else {name: value}
    return {key: float(np.asarray(x)) for key, x in values.items()}


def _copy(array: Any) -> Any:
    copy = np.array(array)
    copy.setflags(write=False)
    return copy


def _observable_row(problem: Problem, name: str, m: int, start: Start | None) -> Row:
    lam = np.zeros(m) if start is None or start.found is None else start.found.lam

    def value() -> Any:
        return real_values(name, problem.observables[name](problem.t_span[0], *map(_copy, (problem.q0, problem.v0, lam))))

    outcome = attempt(value)
    fault = outcome.fault or ("" if np.all(np.isfinite(outcome.value)) else f"got {outcome.value}")
    return yes_or_fault(
        f"data/observable/{name}", f"the observable {name} is finite at the start", fault, "finite", "finite"
    )


def _solution_row(row_id: str, claim: str, problem: Problem, sizes: Sizes, state: Callable[[], Any], bound: float) -> Row:
    """Return a row that compares q and v of a known solution, given by ``state``, with the start."""

    def apart() -> dict[str, float]:
        found = {}
        for name, given, wanted, size in zip("qv", state(), (problem.q0, problem.v0), (sizes.q, sizes.v), strict=True):
            values = real_values(name, given)
            if values.shape != wanted.shape:
                raise ValueError(f"{name} must have shape {wanted.shape}; got {values.shape}")
            found[name] = float(np.max(np.abs(values - wanted) / size))
        return found

    outcome = attempt(apart)
    text = f"{bound:.0e} of the typical size"
    if outcome.fault:
        return yes_or_fault(row_id, claim, outcome.fault, "", text)
    holds = all(x <= bound for x in outcome.value.values())
    worst: Any = max(outcome.value.values())
    measured = worst if holds else ", ".join(f"{name} differs by {x:.2g}" for name, x in outcome.value.items())
    return Row(id=row_id, claim=claim, measured=measured, bound=text, passed=holds)


def _reference_row(problem: Problem, sizes: Sizes) -> Row:
    """Return a row: shapes of the reference fit, and its row at the start, if any, equals q0 and v0 to its digits."""
    reference: Any = problem.reference
    claim = "the reference fits the problem and agrees with q0, v0 where it starts there"

    def row_at_start() -> int | None:
        t = real_values("t", reference["t"])
        for name in ("q", "v"):
            shape = real_values(name, reference[name]).shape
            if shape != (t.size, problem.q0.size):
                raise ValueError(f"{name} must have shape ({t.size}, {problem.q0.size}); got {shape}")
        return next(iter(np.flatnonzero(t == problem.t_span[0]).tolist()), None)

    row = attempt(row_at_start)
    if row.fault or row.value is None:
        return yes_or_fault("data/reference", claim, row.fault, "fits; it has no row at the start", "fits")
    bound = max(CONSISTENT, 10.0 ** -int(reference.get("digits", 8)))
    start = lambda: (reference["q"][row.value], reference["v"][row.value])  # noqa: E731
    return _solution_row("data/reference", claim, problem, sizes, start, bound)
