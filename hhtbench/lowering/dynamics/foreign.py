"""Functions of a NumPy system as operations of machine code: calls back into Python by address.

Formulas are traced as for any system; each function of the system itself is one operation, ``foreign_p``, which
machine code performs as a call.  Addresses are parameters, so that code is shared by all systems of one structure.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import accumulate
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray

from hhtbench.lowering.dynamics.callbacks import Callbacks, Shape
from hhtbench.lowering.dynamics.dynamics import Dynamics, Structure, arguments_of, as_declared, innermost
from hhtbench.lowering.dynamics.numpy_dynamics import NumpyDynamics
from hhtbench.lowering.jax_internals import Primitive
from hhtbench.protocol.system import SIGNATURES, WITH_VELOCITY, Signature, declared

foreign_p = Primitive("hhtbench_foreign")
foreign_p.def_abstract_eval(lambda address, *arguments, shape: ShapedArray(shape, np.dtype(np.float64)))

UNDECLARED = {  # sizes of results of functions that no user declares
    "constraint_rows": ("mn",),
    "constraint_velocity": ("m",),
    "velocity_constraint_rows": ("pn",),
    "mass_product_jacobian": ("nn",),
    "constraint_velocity_jacobian": ("mn",),
    "velocity_constraint_position_jacobian": ("pn",),
    "velocity_constraint_acceleration": ("p",),
    "velocity_reaction_jacobians": ("nn", "np"),
}
FUNCTIONS = {"mass": SIGNATURES["mass_matrix"]} | {
    name: SIGNATURES[name] if name in SIGNATURES else Signature(arguments_of(name), UNDECLARED[name])
    for name in (*SIGNATURES, *UNDECLARED)
    if hasattr(Dynamics, name)
}


def functions_of(s: Structure) -> dict[str, Signature]:
    """``FUNCTIONS``, with the reactions' signatures of this structure."""
    return FUNCTIONS | WITH_VELOCITY if s.reaction_uses_v else FUNCTIONS


BY_ROWS = {  # functions that follow from Jacobians, where these are declared
    "constraint_rows": "constraint_jacobian",
    "constraint_velocity": "constraint_jacobian",
    "velocity_constraint_rows": "velocity_constraint_jacobian",
}
SIZES = {"t": "", "q": "n", "v": "n", "x": "n", "lam": "m", "mu": "p"}  #: sizes of arguments, by letter


class Called(eqx.Module, Dynamics):
    """Base class: a dynamics of plain callables that can be traced."""

    addresses: Any  #: (functions,) float64 holding the bits of the functions' addresses
    callbacks: Callbacks = eqx.field(static=True)
    noise: float = eqx.field(static=True)  # type: ignore[misc] # roundoff of the dynamics' functions
    structure: Structure = eqx.field(static=True)

    @property
    def system(self) -> Any:
        """The NumpySystem."""
        return self.callbacks.system

    @property
    def xp(self) -> Any:
        """The array namespace of this dynamics."""
        return jnp


class ForeignDynamics(Called):
    """Traceable dynamics of plain callables with full matrices; see :class:`~.jax_dynamics.JaxDynamics`."""

    own: tuple[str, ...] = eqx.field(static=True)  #: the functions that are called; the rest are derived from them
    constant_mass: Any = None  #: (n, n) when the mass is a constant
    inverse_mass: Any = None  #: (n, n) its inverse, likewise

    def gives(self, name: str) -> bool:
        """True if ``name`` is called, not derived."""
        return name in self.own

    def call(self, name: str, t: Any, *arguments: Any) -> Any:
        """Result of the function ``name``, an array or several."""
        results = functions_of(self.structure)[name].results
        address, shape = self.addresses[list(FUNCTIONS).index(name)], _shape(results, self.structure)
        floats = (jnp.asarray(argument, dtype=float) for argument in (t, *arguments))
        value = foreign_p.bind(address, *floats, shape=shape)
        if len(results) == 1:
            return value
        ends = list(accumulate(getattr(self.structure, letters[1]) for letters in results))
        return tuple(value[:, first:end] for first, end in zip([0, *ends], ends, strict=False))


def foreign(dynamics: Dynamics) -> ForeignDynamics:
    """Make ``dynamics`` of plain callables on NumPy arrays traceable."""
    s, callbacks = dynamics.structure, Callbacks(dynamics.system)
    users = dynamics.functions if isinstance(dynamics, NumpyDynamics) else {}  # functions that may themselves be copies
    addresses = []
    for name, (arguments, results) in functions_of(s).items():
        function = users.get("mass_matrix" if name == "mass" else name) or as_declared(dynamics, name)
        if len(results) > 1:
            function = partial(_joined, function, s.n)
        addresses.append(
            callbacks.row(function, _shape(results, s), tuple(_shape((SIZES[symbol],), s) for symbol in arguments))
        )
    masses = (None if mass is None else np.asarray(mass) for mass in (dynamics.constant_mass, dynamics.inverse_mass))
    derived = {name for name in ("reaction", "velocity_reaction") if declared(dynamics.system, name) is None}
    inner = innermost(dynamics)
    derived |= {name for name, rows in BY_ROWS.items() if inner.gives(rows)}
    bits = np.array(addresses, dtype=np.uint64).view(np.float64)
    own = tuple(name for name in FUNCTIONS if name not in derived and (name != "mass" or s.mass == "variable"))
    return ForeignDynamics(bits, callbacks, inner.noise, s, own, *masses)


def _joined(function: Callable[..., Any], n: int, *arguments: Any) -> Any:
    """The matrices that ``function`` returns, side by side; zeros for None."""
    return np.concatenate([np.zeros((n, n)) if part is None else part for part in function(*arguments)], axis=1)


def _shape(sizes: tuple[str, ...], s: Structure) -> Shape:
    """Shape of an array whose sizes are given by letters, or of matrices side by side."""
    first, *others = (tuple(getattr(s, letter) for letter in letters) for letters in sizes)
    return (first[0], first[1] + sum(other[1] for other in others)) if others else first
