"""What becomes of the rows that a library has given, and which multipliers it holds itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.lowering import Dynamics, padded
from hhtbench.lowering.dynamics.kkt import Acceleration
from solvers._ending import OwnMultipliers
from solvers.forms.form import Form

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


@dataclass
class Kept:
    """States that a run keeps on its way."""

    times: list[float] = field(default_factory=list)  #: [s]
    states: list[Vector] = field(default_factory=list)  #: (size,) each
    rates: list[Vector] = field(default_factory=list)  #: of the multipliers' integrals, where form and library have them

    def drop_last(self) -> None:
        """Forget the last one."""
        del self.times[-1], self.states[-1], self.rates[-1:]

    def rows(self, form: Form) -> Rows:
        """All as arrays of their own."""
        y = np.array(self.states).reshape(-1, form.size)
        q, v = (part.copy() for part in form.state(y))
        complete = self.rates and len(self.rates) == len(self.times)
        return Rows(np.array(self.times), y, q, v, np.array(self.rates).reshape(len(self.rates), -1) if complete else None)


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
