"""What becomes of the rows that a library has given: are they to be believed, and which multipliers belong to them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Work
from hhtbench.errors import BudgetSpent, NonFiniteValue
from hhtbench.lowering import AccelerationLevel, ConstraintLevels, Dynamics, padded
from hhtbench.lowering.dynamics.kkt import Acceleration
from hhtbench.protocol import Scales
from hhtbench.result import Status
from solvers._start import acceleration_at
from solvers.forms.form import Form

BELIEVABLE = 0.1  # constraint violation in units of the typical size: beyond it the rows show another mechanism
CHECKED_ROWS = 200  # rows looked at by that check, the last one included: more would cost more than the steps
INTEGRALS = ("Lam", "Mu")  # unknowns whose rates are the multipliers


@dataclass(frozen=True)
class Rows:
    """Rows at output times or steps, as the library gave them."""

    t: Vector  #: (k,) [s]
    y: Matrix  #: (k, size)
    q: Matrix  #: (k, n)
    v: Matrix  #: (k, n)
    rates: Matrix | None  #: (k, m + p) rates of the multipliers' integrals; None where the form or the library has none


class Recovered(NamedTuple):
    """Multipliers (k, m) and (k, p) of the acceleration level; fewer rows where it is not finite.  ``note`` says so."""

    lam: Matrix
    mu: Matrix
    note: str = ""
    instead: Status | None = None  #: of a success, where rows are missing or not recovered


def make_rows(form: Form, times: list[float], states: list[Vector], rates: list[Vector]) -> Rows:
    """The kept rows as arrays of their own."""
    y = np.array(states).reshape(-1, form.size)
    q, v = (part.copy() for part in form.state(y))
    complete = holds_integrals(form) and len(rates) == len(times)
    return Rows(np.array(times), y, q, v, np.array(rates).reshape(len(rates), -1) if complete and rates else None)


def holds_integrals(form: Form) -> bool:
    """Whether the multipliers are rates of unknowns of this form."""
    return any(name in form.blocks for name in INTEGRALS)


def rates_of(form: Form, yp: Vector) -> Vector:
    """Rates (m + p,) of the multipliers' integrals in y'."""
    return np.concatenate([yp[form.blocks[name]] for name in INTEGRALS if name in form.blocks])


def carried(form: Form, rows: Rows, dynamics: Dynamics) -> Mapping[str, Matrix] | None:
    """The multipliers that the solver itself holds, "lam" (k, m) and "mu" (k, p); None where it has none.

    Zero for redundant rows, which the solver leaves out.
    """
    if rows.rates is not None:
        m = dynamics.structure.m
        lam, mu = padded(dynamics, rows.rates[:, :m], rows.rates[:, m:])
        return {"lam": lam, "mu": mu}
    if not any(name in form.blocks for name in ("lam", "mu")):
        return None
    lam, mu = (rows.y[:, form.blocks.get(name, slice(0, 0))].copy() for name in ("lam", "mu"))
    return dict(zip(("lam", "mu"), padded(dynamics, lam, mu), strict=True))


def doubt_about(rows: Rows, levels: ConstraintLevels, scales: Scales, work: Work, wanted: Vector | None) -> str:
    """What speaks against the rows of a success, in words; empty when nothing does.  ``wanted``: their times.

    Raises
    ------
    BudgetSpent
        The time budget ended before all was looked at.
    """
    if wanted is not None and not np.array_equal(rows.t, wanted):
        return f"It gave {rows.t.size} of {wanted.size} rows."
    if not np.isfinite(rows.y).all():
        return f"The row at t = {rows.t[np.argmin(np.isfinite(rows.y).all(axis=1))]:.17g} is not finite."
    if not levels.structure.constrained or not rows.t.size:
        return ""
    return worst_violation(levels, rows, scales, work)


def worst_violation(levels: ConstraintLevels, rows: Rows, scales: Scales, work: Work) -> str:
    """The largest violation of the constraints in words, with its time; empty where all rows are believable."""
    largest, at_time = 0.0, 0.0
    for i in np.unique(np.linspace(0, rows.t.size - 1, CHECKED_ROWS).astype(int)):
        work.check_time()
        try:
            at = levels.at(float(rows.t[i]), rows.q[i], rows.v[i])
        except NonFiniteValue as error:
            return f"{error}."
        velocity = at.scaled_velocity(scales.v)[at.position.size :]
        worst = float(np.max(np.concatenate([at.scaled_position(scales.q), velocity])))
        if not worst <= largest:  # NaN counts as larger than all
            largest, at_time = worst, float(rows.t[i])
        if np.isnan(worst):
            break
    if largest <= BELIEVABLE:
        return ""
    return f"A constraint is violated by up to {largest:.2g} of its size, most at t = {at_time:.17g}."


def own_multipliers(form: Form, y: Vector, otherwise: tuple[Vector, Vector]) -> tuple[Vector, Vector]:
    """The multipliers that the form carries in ``y``, else ``otherwise``: they pick the root of a nonlinear reaction."""
    lam, mu = (
        y[form.blocks[name]] if name in form.blocks else other for name, other in zip(("lam", "mu"), otherwise, strict=True)
    )
    return lam, mu


def late_note(recovered: int, times: Vector, work: Work) -> str:
    """That the time budget has ended before all rows had their multipliers, in words."""
    ended = f"The time budget ended when {recovered} of {times.size} rows had their multipliers"
    return f"{ended}{work.clock.passed_in}"


def recover_multipliers(
    level: AccelerationLevel, dynamics: Dynamics, work: Work, form: Form, first: Acceleration, rows: Rows
) -> Recovered:
    """lam (k, m) and mu (k, p) from the acceleration level, as far as the time budget goes.

    Rows end before a time where it is not finite.
    """
    s = dynamics.structure
    lam, mu = np.full((rows.t.size, s.m), np.nan), np.full((rows.t.size, s.p), np.nan)
    if not s.constrained:
        return Recovered(lam, mu)
    guesses, undetermined_at = (first.lam, first.mu), []
    for i, t in enumerate(rows.t):
        guesses = own_multipliers(form, rows.y[i], guesses)
        try:
            work.check_time()
            found = acceleration_at(level, dynamics, work, float(t), rows.q[i], rows.v[i], guesses)
        except BudgetSpent:
            for k in range(i, rows.t.size):
                lam[k], mu[k] = own_multipliers(form, rows.y[k], (lam[k], mu[k]))
            note = f"{late_note(i, rows.t, work)}; the rest are those of the form, NaN where it has none."
            return Recovered(lam, mu, note, Status.deadline)
        except NonFiniteValue as error:
            note = f"{error}, when the multipliers were recovered."
            return Recovered(lam[:i], mu[:i], note, Status.nonfinite_callback)
        if not found.converged:
            undetermined_at.append(float(t))
        else:
            guesses = found.lam, found.mu
        lam[i], mu[i] = guesses
    if not undetermined_at:
        return Recovered(lam, mu)
    note = f"The acceleration level determines no multipliers at {len(undetermined_at)} times, first at t = "
    return Recovered(lam, mu, f"{note}{undetermined_at[0]:.17g}; the values of the form or of the row before stand there.")
