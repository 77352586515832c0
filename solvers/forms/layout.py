"""Unknowns and equations of each form, and its residual and Jacobian as pure functions of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

from hhtbench.lowering import Dynamics, Structure
from solvers.forms.rows import ROWS, Blocks, Point

if TYPE_CHECKING:
    from hhtbench.lowering.compile.coloured import Pattern


class Source(NamedTuple):
    """The quantities of Point that a block of unknowns and its derivative stand for."""

    value: str | None
    rate: str | None


SOURCES = {
    "q": Source("q", "qdot"),
    "v": Source("v", "vdot"),
    "lam": Source("lam", None),
    "mu": Source("mu", None),
    "eta": Source("eta", None),
    "Lam": Source(None, "lam"),  # (F8)
    "Mu": Source(None, "mu"),
    "Eta": Source(None, "eta"),
}


class Recipe(NamedTuple):
    """Unknowns and equations of a form; blocks of undeclared constraints are dropped later."""

    unknowns: tuple[str, ...]
    rows: tuple[str, ...]


RECIPES = {
    "index3": Recipe(("q", "v", "lam", "mu"), ("kinematics", "force", "position", "velocity_constraint")),
    "index2": Recipe(("q", "v", "lam", "mu"), ("kinematics", "force", "velocity", "velocity_constraint")),
    "ggl": Recipe(("q", "v", "lam", "mu", "eta"), ("kinematics", "force", "velocity", "velocity_constraint", "position")),
    "index1": Recipe(("q", "v", "lam", "mu"), ("kinematics", "force", "acceleration", "velocity_constraint_rate")),
    "integrated": Recipe(
        ("q", "v", "Lam", "Mu", "Eta"), ("kinematics", "force", "velocity", "velocity_constraint", "position")
    ),
    "ode": Recipe(("q", "v"), ()),
}


@dataclass(frozen=True)
class Layout:
    """A form of a given structure: determines the compiled code.  Hashable."""

    name: str
    structure: Structure

    @property
    def sizes(self) -> dict[str, int]:
        """Number of unknowns in each block; empty blocks are left out."""
        s = self.structure
        sizes = {"q": s.n, "v": s.n, "lam": s.m, "mu": s.p, "eta": s.m, "Lam": s.m, "Mu": s.p, "Eta": s.m}
        return {name: sizes[name] for name in RECIPES[self.name].unknowns if sizes[name]}

    @property
    def size(self) -> int:
        """Number of unknowns, and of equations."""
        return sum(self.sizes.values())

    @property
    def blocks(self) -> Mapping[str, slice]:
        """Slice of each block in y."""
        places, start = {}, 0
        for name, size in self.sizes.items():
            places[name] = slice(start, start + size)
            start += size
        return MappingProxyType(places)

    @property
    def rows(self) -> list[str]:
        """Names of the blocks of equations, those of undeclared constraints left out."""
        s = self.structure
        absent = set() if s.m else {"position", "velocity", "acceleration"}
        absent |= set() if s.p else {"velocity_constraint", "velocity_constraint_rate"}
        return [name for name in RECIPES[self.name].rows if name not in absent]

    def point(self, dynamics: Dynamics, t: Any, y: Any, yp: Any) -> Point:
        """The quantities of the equations at ``y, yp`` (size,), as a Point."""
        quantities = {}
        for name, place in self.blocks.items():
            source = SOURCES[name]
            if source.value is not None:
                quantities[source.value] = y[place]
            if source.rate is not None:
                quantities[source.rate] = yp[place]
        return Point(dynamics=dynamics, t=t, **quantities)


class Functions(NamedTuple):
    """Compiled functions of one form."""

    value: Callable[..., Any]  #: F(t, y, y') or y'(t, y), (size,)
    jacobian: Callable[..., Any]  #: at (t, y, y', c) or (t, y): (size, size), or of a pattern the entries (entries,)
    pattern: Pattern | None = None
    outside: Callable[[bool], bool] | None = None  #: see :attr:`~solvers.forms.form.Form.outside`


def residual_function(dynamics: Dynamics, layout: Layout, t: Any, y: Any, yp: Any) -> Any:
    """F(t, y, y') (size,) of a DAE form."""
    at = layout.point(dynamics, t, y, yp)
    return dynamics.xp.concatenate([ROWS[name].value(at) for name in layout.rows])


def residual_along(dynamics: Dynamics, layout: Layout, y: Any, t: Any, place: Any, yp: Any, c: Any) -> Any:
    """F(t, y, y' + c (y - place)) (size,); its derivative by y at ``place`` is :func:`jacobian_function`."""
    return residual_function(dynamics, layout, t, y, yp + c * (y - place))


def jacobian_function(dynamics: Dynamics, layout: Layout, t: Any, y: Any, yp: Any, c: Any) -> Any:
    """dF/dy + c dF/dy' (size, size) of a DAE form; ``c`` [1/s] comes from the integrator."""
    at = layout.point(dynamics, t, y, yp)
    rows = [_matrix_row(layout, ROWS[name].derivatives(at), c, dynamics.xp) for name in layout.rows]
    return dynamics.xp.concatenate(rows, axis=0)


def _matrix_row(layout: Layout, blocks: Blocks, c: Any, xp: Any) -> Any:
    """Rows (rows, size) of the Jacobian for one block of equations."""
    height = next(block.shape[0] for block in blocks.values() if block is not None)
    columns = []
    for name, size in layout.sizes.items():
        source = SOURCES[name]
        direct = blocks.get(source.value) if source.value else None
        rate = blocks.get(source.rate) if source.rate else None
        column = direct if rate is None else c * rate if direct is None else direct + c * rate
        columns.append(xp.zeros((height, size)) if column is None else column)
    return xp.concatenate(columns, axis=1)
