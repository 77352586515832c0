"""What becomes of the rows that a library has given: are they to be believed, and which multipliers does it hold itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Work
from hhtbench.errors import NonFiniteValue
from hhtbench.lowering import ConstraintLevels, Dynamics, padded
from hhtbench.lowering.dynamics.kkt import Acceleration
from hhtbench.protocol import Scales
from solvers._ending import OwnMultipliers
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

    @property
    def motion(self) -> tuple[Vector, Matrix, Matrix]:
        """t, q and v."""
        return self.t, self.q, self.v


def make_rows(form: Form, times: list[float], states: list[Vector], rates: list[Vector]) -> Rows:
    """The rows as arrays of their own."""
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
        own = np.split(rows.rates, [dynamics.structure.m], axis=1)
    elif any(name in form.blocks for name in ("lam", "mu")):
        own = [rows.y[:, form.blocks.get(name, slice(0, 0))].copy() for name in ("lam", "mu")]
    else:
        return None
    return dict(zip(("lam", "mu"), padded(dynamics, *own), strict=True))


def doubt_about(rows: Rows, wanted: Vector | None) -> str:
    """What speaks against the rows of a success, in words; empty when nothing does.  ``wanted``: their times."""
    if wanted is not None and not np.array_equal(rows.t, wanted):
        return f"It gave {rows.t.size} of {wanted.size} rows."
    if not np.isfinite(rows.y).all():
        return f"The row at t = {rows.t[np.argmin(np.isfinite(rows.y).all(axis=1))]:.17g} is not finite."
    return ""


def worst_violation(levels: ConstraintLevels, rows: Rows, scales: Scales, work: Work) -> str:
    """The largest violation of the constraints in words, with its time; empty where all rows are believable.

    Raises
    ------
    BudgetSpent
        The time budget ended before all was looked at.
    """
    if not levels.structure.constrained or not rows.t.size:
        return ""
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


def own_multipliers(form: Form, rows: Rows, dynamics: Dynamics, first: Acceleration) -> OwnMultipliers:
    """The multipliers among the unknowns of the form, NaN where it has none."""
    s, k, every = dynamics.structure, rows.t.size, "those of the form, NaN where it has none"
    return OwnMultipliers(
        lam=rows.y[:, form.blocks["lam"]].copy() if "lam" in form.blocks else np.full((k, s.m), np.nan),
        mu=rows.y[:, form.blocks["mu"]].copy() if "mu" in form.blocks else np.full((k, s.p), np.nan),
        first=(first.lam, first.mu),
        every=every,
        rest=f"the rest are {every}",
        some="the values of the form or of the row before stand there",
    )
