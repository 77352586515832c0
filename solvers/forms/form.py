"""``make_form``: one form (F1)-(F9) of a system as compiled functions, with its layout of unknowns and error weights."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hhtbench.lowering import Dynamics, Structure, route_of
from hhtbench.lowering.caching import Cache, by_id
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import ProblemError, did_you_mean
from solvers.forms.functions import dae_functions, ode_functions
from solvers.forms.layout import RECIPES, SOURCES, Layout

if TYPE_CHECKING:
    from hhtbench.lowering.compile.coloured import Pattern

FORMS = tuple(RECIPES)
MASKED = 1e8  # atol that excludes an entry from an error test: far above any multiplier times rtol
MULTIPLIERS = ("lam", "mu", "eta")
_made = Cache(64)  # finding the functions again takes as long as ten calls of them


@dataclass(frozen=True)
class Start:
    """Consistent start vectors y and dy/dt."""

    y: Vector  #: (size,)
    yp: Vector  #: (size,) dy/dt; zero for multipliers, whose derivative is in no equation


class State(NamedTuple):
    """Views of a packed row or rows: (n,) each, or (k, n)."""

    q: NDArray[np.float64]
    v: NDArray[np.float64]


def _no_dae(*_: Any) -> Any:
    raise ProblemError("the form ode has no residual; call rhs, or take a dae form.")


def _no_ode(*_: Any) -> Any:
    raise ProblemError("a dae form has no right-hand side; call residual, or take the form ode.")


def _never(_: bool) -> bool:
    return False


@dataclass(frozen=True, kw_only=True)
class Form:
    """One form of one system.  Its functions return new arrays, read-only for JAX systems."""

    name: str
    kind: str  #: "dae" or "ode"
    size: int  #: number of unknowns
    blocks: Mapping[str, slice]  #: slices of q, v and, where the form has them, lam, mu, eta, Lam, Mu, Eta in y
    differential: NDArray[np.bool_]  #: (size,) True where the entry's derivative is in the equations
    multipliers: NDArray[np.bool_]  #: (size,) True for entries that must not be in an error test
    points: int  #: evaluations of F per call of a function; 0 for plain callables, which are counted one by one
    residual: Callable[[float, Vector, Vector], Vector] = _no_dae  #: dae: F(t, y, yp) (size,)
    jacobian: Callable[[float, Vector, Vector, float], Matrix] = _no_dae  #: dae: dF/dy + c dF/dyp at (t, y, yp, c)
    rhs: Callable[[float, Vector], Vector] = _no_ode  #: ode: y' (size,) at (t, y); not finite where (F9) is singular
    rhs_jacobian: Callable[[float, Vector], Matrix] = _no_ode  #: ode: dy'/dy (size, size) at (t, y)
    pattern: Pattern | None = None  #: sparsity; if given, Jacobians return only its entries (entries,)
    #: (whether dy'/dy is needed too) -> whether ``rhs`` calls no XLA code and is faster than XLA's code of (F9)
    outside: Callable[[bool], bool] = _never

    def start(self, q: Vector, v: Vector, vdot: Vector, lam: Vector, mu: Vector) -> Start:
        """Start vectors from a consistent state and its acceleration level: ``q, v, vdot`` (n,), ``lam`` (m,), ``mu`` (p,).

        eta starts at 0, as do the integrals.
        """
        y, yp = np.zeros(self.size), np.zeros(self.size)
        rates = {"q": v, "v": vdot, "Lam": lam, "Mu": mu}
        for name, values in {"q": q, "v": v, "lam": lam, "mu": mu}.items():
            if name in self.blocks:
                y[self.blocks[name]] = values
        for name, values in rates.items():
            if name in self.blocks:
                yp[self.blocks[name]] = values
        return Start(y, yp)

    def matrix(self, jacobian: Vector | Matrix, *, full: bool = True) -> Any:
        """The matrix (size, size) from a Jacobian's values; a csc_array if there is a pattern and not ``full``."""
        if self.pattern is None:
            return jacobian
        found = self.pattern.matrix(jacobian)
        return found.toarray() if full else found.tocsc()

    def state(self, y: NDArray[np.float64]) -> State:
        """Views of q and v in ``y``, (size,) or (k, size)."""
        return State(y[..., self.blocks["q"]], y[..., self.blocks["v"]])

    def error_weights(self, atol: Any) -> Vector:
        """Absolute tolerances (size,): ``atol`` for q and v, MASKED for multipliers, the largest atol for their integrals.

        Parameters
        ----------
        atol
            A number, or (n,) for q and v alike, or (2n,) for q and then v.
        """
        n = self.blocks["q"].stop
        given = np.asarray(atol, dtype=np.float64)
        if given.shape not in ((), (n,), (2 * n,)):
            raise ProblemError(f"atol must be a number, ({n},) or ({2 * n},); got shape {given.shape}.")
        weights = np.full(self.size, given.max())
        weights[: 2 * n] = np.tile(given, 2) if given.shape == (n,) else given
        weights[self.multipliers] = MASKED
        return weights


def refusal(name: str, structure: Structure) -> str | None:
    """Reason why the form ``name`` does not exist for a system of this structure, or None.

    Raises
    ------
    ProblemError
        There is no form of that name; the message names the closest.
    """
    _check_name(name)
    if not structure.constrained and name not in ("ggl", "index1", "ode"):  # where ggl is index1
        text = f"the form {name} treats constraints and the system has none"
        return f"{text}; take form=index1 (of CVODE, SciPy and diffrax: form=ode)."
    if name == "index3" and not structure.m:
        return (
            "the system has velocity constraints only, so its index is 2 and index3 would be index2; take the form index2."
        )
    iterated = structure.linear_reaction or structure.reaction_uses_v  # friction: the root is that next to none of it
    if name == "ode" and not iterated:
        return (
            "the form ode eliminates the multipliers by one linear solve, but a declared reaction is nonlinear in them "
            "(or is a plain callable that cannot be read); take one of the dae forms."
        )
    return None


def make_form(name: str, dynamics: Dynamics) -> Form:
    """The form ``name`` (one of FORMS) of ``dynamics``, compiled on first use; remembered.

    Raises
    ------
    ProblemError
        There is no form of that name, or the system does not have it: see :func:`refusal`.
    """
    made: Form = _made.find((name, by_id(dynamics)), lambda: _make_form(name, dynamics))
    return made


def _make_form(name: str, dynamics: Dynamics) -> Form:
    layout = Layout(name, dynamics.structure)
    reason = refusal(name, dynamics.structure) or _undetermined(name, dynamics)
    if reason is not None:
        raise ProblemError(reason)
    common: dict[str, Any] = {
        "name": name,
        "size": layout.size,
        "blocks": layout.blocks,
        "differential": _differential(layout, dynamics),
        "multipliers": _mask(layout, MULTIPLIERS),
        "points": 0 if route_of(dynamics) == "numpy" else 1,
    }
    if name == "ode":
        rhs, jacobian, pattern, outside = ode_functions(dynamics)
        return Form(kind="ode", rhs=rhs, rhs_jacobian=jacobian, pattern=pattern, outside=outside or _never, **common)
    residual, jacobian, pattern, _ = dae_functions(dynamics, layout)
    return Form(kind="dae", residual=residual, jacobian=jacobian, pattern=pattern, **common)


def _check_name(name: str) -> None:
    if name in FORMS:
        return
    hint = did_you_mean(str(name), FORMS)
    raise ProblemError(f"there is no form {name!r}.{hint} Forms: {', '.join(FORMS)}.")


def _undetermined(name: str, dynamics: Dynamics) -> str | None:
    s = dynamics.structure
    if name != "ode" or s.constrained or s.mass != "constant" or dynamics.inverse_mass is not None:
        return None
    return "the mass matrix is singular and no constraint determines the accelerations; give every coordinate a mass."


def _mask(layout: Layout, names: tuple[str, ...]) -> NDArray[np.bool_]:
    """(size,) True in the blocks of these ``names``."""
    mask = np.zeros(layout.size, dtype=bool)
    for name, place in layout.blocks.items():
        mask[place] = name in names
    mask.setflags(write=False)
    return mask


def _differential(layout: Layout, dynamics: Dynamics) -> NDArray[np.bool_]:
    """(size,) True where the derivative is in the equations: not for multipliers, nor for a velocity without mass."""
    mask = _mask(layout, tuple(name for name, source in SOURCES.items() if source.rate is not None)).copy()
    every = layout.name == "index1" and layout.structure.constrained  # (F5) and (F7) hold the v' that M lacks
    if layout.structure.mass == "constant" and not every:
        mask[layout.blocks["v"]] = np.any(np.asarray(dynamics.constant_mass) != 0, axis=0)
    mask.setflags(write=False)
    return mask
