"""Lowering: from a system's equations to fast functions, by one of several routes with the same values.

``derive(system, t, q, v)`` gives a :class:`Dynamics` (JAX or NumPy); ``compile_function`` makes a function of it callable
from Python, ``native`` gives HHT's loops its machine code by address, and :mod:`~hhtbench.lowering.compile.loops` builds and
loads those loops themselves.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from hhtbench.lowering.compile.compiling import compile_function, routes
from hhtbench.lowering.compile.routes import route_of, too_large
from hhtbench.lowering.dynamics.derive import derive
from hhtbench.lowering.dynamics.dynamics import Dynamics, Structure
from hhtbench.lowering.dynamics.levels import CONSISTENT, ConstraintLevels, Levels, Misfit, size_of
from hhtbench.lowering.dynamics.mass import SYMMETRIC, asymmetry, mass_at, mass_is_singular, singular_at
from hhtbench.lowering.dynamics.reductions import REDUCTIONS
from hhtbench.lowering.dynamics.regular import padded, reduce_redundant, redundant_rows, unreduced

if TYPE_CHECKING:
    from hhtbench.lowering.dynamics.augmented import augment
    from hhtbench.lowering.dynamics.kkt import AccelerationLevel
    from hhtbench.lowering.dynamics.operations import operations
    from hhtbench.lowering.dynamics.rank import ConstraintRank, constraint_rank, minimum_norm
    from hhtbench.lowering.scalar_compiler import Native, NotNative, native

__all__ = [
    "CONSISTENT",
    "REDUCTIONS",
    "SYMMETRIC",
    "AccelerationLevel",
    "ConstraintLevels",
    "ConstraintRank",
    "Dynamics",
    "Levels",
    "Misfit",
    "Native",
    "NotNative",
    "Structure",
    "asymmetry",
    "augment",
    "compile_function",
    "constraint_rank",
    "derive",
    "mass_at",
    "mass_is_singular",
    "minimum_norm",
    "native",
    "operations",
    "padded",
    "reduce_redundant",
    "redundant_rows",
    "route_of",
    "routes",
    "singular_at",
    "size_of",
    "too_large",
    "unreduced",
]

_MODULES = {  # imported on first use, as most solves do not need them
    "scalar_compiler": ("Native", "NotNative", "native"),
    "dynamics.augmented": ("augment",),
    "dynamics.kkt": ("AccelerationLevel",),
    "dynamics.operations": ("operations",),
    "dynamics.rank": ("ConstraintRank", "constraint_rank", "minimum_norm"),
}
_LATER = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_LATER[name]), name)
    return value
