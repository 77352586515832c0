"""The physics, written once: what a user declares and every solver receives.

Read this file first.  A **System** is the physics, a **Problem** adds a start, an interval and what to
measure, a **Solver** turns a Problem and a Request into a Solution.

Symbols, used with this meaning everywhere:

=========  =========  ==============================================================  ==============
symbol     shape      meaning                                                         unit
=========  =========  ==============================================================  ==============
``t``      scalar     time                                                            s
``q``      (n,)       generalised coordinates                                         m, rad
``v``      (n,)       velocities, dq/dt                                               m/s, rad/s
``vdot``   (n,)       accelerations, dv/dt                                            m/s^2, rad/s^2
``a``      (n,)       the HHT method's auxiliary accelerations (not dv/dt at t)       m/s^2, rad/s^2
``lam``    (m,)       multipliers of the position constraints                         N, N m
``mu``     (p,)       multipliers of the velocity constraints                         N, N m
``M``      (n, n)     mass matrix                                                     kg, kg m^2
``F``      (n,)       applied generalised force                                       N, N m
``Q``      (n,)       reaction (constraint) force                                     N, N m
``f, r``   (n,)       ``M^-1 F``, ``M^-1 Q``                                          m/s^2, rad/s^2
``g``      (m,)       position constraints, ``0 = g(t, q)``                           m, rad
``g_q``    (m, n)     their Jacobian, ``G`` for short
``k``      (p,)       velocity constraints, ``0 = k(t, q, v)``                        m/s, rad/s
``k_v``    (p, n)     their Jacobian with respect to v, ``K`` for short
``h``      scalar     step                                                            s
``alpha``  scalar     damping parameter of the HHT method, in [-1/3, 0]
``beta``   scalar     Newmark weight of the end acceleration in the position
``gamma``  scalar     Newmark weight of the end acceleration in the velocity
``b``      scalar     weight of the end reaction in the position
=========  =========  ==============================================================  ==============

The equations are ``q' = v``, ``M(t,q) v' = F(t,q,v) + Q``, ``0 = g(t,q)``, ``0 = k(t,q,v)``.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import time
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hhtbench.protocol.arguments import real_array
from hhtbench.protocol.errors import ProblemError

if TYPE_CHECKING:
    pass


class Signature(NamedTuple):
    """Arguments and result shapes of a function that a system may declare."""

    arguments: tuple[str, ...]  #: symbols of the table above
    results: tuple[str, ...]  #: sizes of the array by letter, "mn" is (m, n); two: a pair; none: a dict of scalars

    def shapes(self, n: int, m: int, p: int) -> tuple[tuple[int, ...], ...]:
        """Return the shapes of the results for n coordinates, m position and p velocity constraints."""
        return tuple(tuple({"n": n, "m": m, "p": p}[letter] for letter in letters) for letters in self.results)


def _signature(arguments: str, *results: str) -> Signature:
    return Signature(tuple(arguments.split()), results)


IMPORTED = time.time()  #: [s]; a file that was changed later need not be the one that made a Problem
PHYSICS = {
    "force": _signature("t q v", "n"),
    "mass_matrix": _signature("t q", "nn"),
    "constraint": _signature("t q", "m"),
    "velocity_constraint": _signature("t q v", "p"),
    "reaction": _signature("t q lam", "n"),
    "velocity_reaction": _signature("t q v mu", "n"),
    "energy": _signature("t q v", ""),
    "power": _signature("t q v lam mu", ""),
    "invariants": _signature("t q v"),
}
DERIVATIVES = {
    "force_jacobians": _signature("t q v", "nn", "nn"),  # F_q, F_v; None for one that is zero
    "constraint_jacobian": _signature("t q", "mn"),
    "constraint_time_derivative": _signature("t q", "m"),
    "constraint_acceleration": _signature("t q v", "m"),  # g_tt + 2 g_tq v + g_qq(v,v): g'' = g_q vdot + this
    "velocity_constraint_jacobian": _signature("t q v", "pn"),  # k_v
    "reaction_jacobians": _signature("t q lam", "nn", "nm"),  # Q_q, Q_lam
}
SIGNATURES = PHYSICS | DERIVATIVES
WITH_VELOCITY = {  # reactions that depend on v too (friction in a joint), recognised by their four arguments
    "reaction": _signature("t q v lam", "n"),
    "reaction_jacobians": _signature("t q v lam", "nn", "nn", "nm"),  # Q_q, Q_v, Q_lam
}
NEAR = 0.8  # similarity by difflib: "constraints" is 0.95 like "constraint", "force_limit" 0.63 like "force"
OTHER_WORDS = dict.fromkeys(("mass", "masses", "M"), "mass_matrix")  # synonyms that difflib does not match
DECLARABLE = (*SIGNATURES, "state_rate", "sparsity")  # the last: a mapping, name of a pattern -> booleans, see PATTERNS
PATTERNS = {  # what ``sparsity`` may hold and its sizes: patterns of M and of derivatives of F, g, k, Q and M x
    "force_q": "nn",
    "force_v": "nn",
    "constraint_jacobian": "mn",
    "velocity_constraint_jacobian": "pn",
    "velocity_constraint_q": "pn",
    "reaction_q": "nn",
    "reaction_v": "nn",
    "mass_matrix": "nn",
    "mass_product_jacobian": "nn",
}


def near_name(name: str) -> str:
    """Return the name in ``DECLARABLE`` that is closest to the misspelt ``name``; empty string if none is close."""
    return OTHER_WORDS.get(name) or next(iter(get_close_matches(name, DECLARABLE, 1, NEAR)), "")


def parameter(default: Any = ..., *, doc: str = "") -> Any:
    """Declare a physical parameter of a :class:`System`; its value is stored as a float64 array.

    A new value of an array reuses the compiled code; a Python float would be traced again.  ``doc`` states meaning and
    unit.
    """
    options: dict[str, Any] = {"converter": lambda x: jnp.array(x, dtype=jnp.float64), "metadata": {"doc": doc}}
    if default is not ...:
        options["default_factory"] = lambda: default  # a factory, so that a default may be an array or a list
    return eqx.field(**options)


class System(eqx.Module):
    """The physics as pure ``jax.numpy`` functions; subclass it and declare what the scene requires, no more.

    Required: ``force(t, q, v) -> (n,)``.  Optional, each costing nothing while undeclared (an attribute that
    is missing or None is undeclared):

    ``mass_matrix``
        Field: scalar, ``(n,)`` or ``(n, n)``; or method ``(t, q) -> (n, n)``, or ``(n,)``, a diagonal.  Identity if
        undeclared; may be singular where the KKT matrix ``[[M, C^T], [C, 0]]`` is regular.
    ``constraint(t, q) -> (m,)``, ``velocity_constraint(t, q, v) -> (p,)``
        ``g`` and ``k``.
    ``reaction(t, q, lam) -> (n,)``, ``velocity_reaction(t, q, v, mu) -> (n,)``
        Generalised reaction forces; ``-g_q^T lam`` and ``-k_v^T mu`` if undeclared.  May be nonlinear in ``lam``.
        ``reaction(t, q, v, lam)``, with ``v`` among its arguments, may depend on velocities too: friction in a joint.
    ``energy(t, q, v) -> scalar``, ``invariants(t, q, v) -> dict of scalars``
        Measured, never used by a solver.
    ``power(t, q, v, lam, mu) -> scalar``
        Power [W] that enters ``energy`` (dampers, forces without a potential, moving constraints): along every motion
        ``d energy/dt = power``.  Undeclared: the energy is conserved.

    ``state_rate(t, q, v, x) -> (k,)``
        Rates of first-order states x, which start at ``Problem.x0``: ``x' = state_rate``.
        Forces, reactions, ``state_rate`` and what is measured take states by a further argument ``x`` and the sampled
        inputs of ``Problem.inputs`` by ``u``, as ``force(t, q, v, x, u)``; a ``velocity_constraint`` takes ``u``.

    The derivatives in ``DERIVATIVES`` may be declared too; automatic differentiation gives those that are not.
    ``sparsity`` maps names in ``PATTERNS`` to boolean arrays, the nonzero patterns of these matrices of large systems; the
    patterns of the other matrices are found from the functions' computation graphs.
    """

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        for name, entry in vars(cls).items():
            if isinstance(entry, dataclasses.Field) and name not in inspect.get_annotations(cls):
                raise _wrong_use().without_annotation(cls, name)
            _expect_order(cls.__name__, name, entry)
        inherited = {name: entry for base in reversed(cls.__mro__[1:]) for name, entry in _fields_of(base).items()}
        own = {name: cls.__dict__.get(name, dataclasses.MISSING) for name in inspect.get_annotations(cls)}
        first = None  # the first parameter with a default
        for name, entry in (inherited | own).items():
            if _has_default(entry):
                first = first or name
            elif first is not None:
                raise _wrong_use().without_default(cls, name, first)

    def __setattr__(self, name: str, value: Any) -> None:
        try:
            super().__setattr__(name, value)
        except dataclasses.FrozenInstanceError:
            raise _wrong_use().assigned(type(self), name) from None


def _wrong_use() -> Any:
    """The page of messages, imported where one is needed."""
    return importlib.import_module("hhtbench.protocol.wrong_use")


def _expect_order(owner: str, name: str, function: Any) -> None:
    """Raise a TypeError if ``function``, declared as ``name``, has the protocol's arguments in another order."""
    if name in SIGNATURES and inspect.isfunction(function):
        found = [argument for argument in inspect.signature(function).parameters if argument != "self"]
        for wanted in {signatures[name].arguments for signatures in (SIGNATURES, WITH_VELOCITY) if name in signatures}:
            if found != [*wanted] and sorted(found) == sorted(wanted):
                raise _wrong_use().in_other_order(owner, name, wanted, found)


def _fields_of(base: type) -> dict[str, Any]:
    return getattr(base, "__dataclass_fields__", {})


def _has_default(entry: Any) -> bool:
    if isinstance(entry, dataclasses.Field):
        return entry.default is not dataclasses.MISSING or entry.default_factory is not dataclasses.MISSING
    return entry is not dataclasses.MISSING


class NumpySystem:
    """The physics as plain callables on NumPy arrays (a wrapped external code, say).

    Its keywords are the names in ``DECLARABLE``; ``force`` is required.  Derivatives that are not declared come from finite
    differences, coloured when ``sparsity`` gives the pattern; the constraints then hold to the error of the difference
    scheme (about 1e-9), not to roundoff.  With the patterns of F_q, F_v, the constraint Jacobians and a variable mass
    matrix a large system is integrated without dense matrices.  The callables receive read-only copies.

    Sizes and a constant mass matrix are stored and used by later solves.  No other result is stored, since the callables
    may be any Python and may refer to what changes.
    """

    def __init__(self, *, force: Callable[..., Any] | None = None, **declared: Any) -> None:
        unknown = sorted(set(declared) - set(DECLARABLE))
        if unknown:
            raise _wrong_use().unknown_names(unknown)
        if force is None:
            raise TypeError("NumpySystem needs force, a function (t, q, v) -> (n,).")
        patterns = checked_patterns(declared.get("sparsity"))
        if patterns:
            declared["sparsity"] = {name: full_pattern(x) for name, x in patterns.items()}
        for name, value in {"force": force, **declared}.items():
            if value is not None and not callable(value) and name not in ("mass_matrix", "sparsity"):
                raise TypeError(f"NumpySystem: {name} must be a function; got {type(value).__name__}.")
            _expect_order("NumpySystem", name, value)
            if name == "mass_matrix" and value is not None and not callable(value):
                value = real_array("mass_matrix", value)
            object.__setattr__(self, name, value)

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"a NumpySystem is not changed after it is made; make a new one with {name}=...")


def declared(system: System | NumpySystem, name: str) -> Any:
    """Return the function or value that ``system`` declares under ``name``, or None."""
    return getattr(system, name, None)


def reaction_takes_velocity(system: System | NumpySystem) -> bool:
    """True if ``reaction`` is a function of (t, q, v, lam); one that also takes (t, q, lam) is called with these three."""
    function = declared(system, "reaction")
    return (
        callable(function) and accepts(function, WITH_VELOCITY["reaction"]) and not accepts(function, SIGNATURES["reaction"])
    )


def accepts(function: Callable[..., Any], signature: Signature) -> bool:
    """True if ``function`` can be called with the arguments of ``signature``, or if Python cannot inspect its signature."""
    try:
        inspect.signature(function).bind(*signature.arguments)
    except TypeError:
        return False
    except ValueError:  # a function of C
        return True
    return True


def signature_of(system: System | NumpySystem, name: str) -> Signature:
    """Return the arguments and result shapes of the function ``name`` of ``system``; reactions may take v or not."""
    with_velocity = name in WITH_VELOCITY and reaction_takes_velocity(system)
    return WITH_VELOCITY[name] if with_velocity else SIGNATURES[name]


def checked_patterns(sparsity: Any) -> Mapping[str, Any]:
    """Return the declared ``sparsity``, patterns by name (arrays or SciPy's sparse matrices); {} for None.

    Raises
    ------
    TypeError, ProblemError
        It is no mapping, or has a name that is not in ``PATTERNS``.
    """
    if sparsity is None:
        return {}
    if not isinstance(sparsity, Mapping):
        raise TypeError(f"sparsity must map names ({', '.join(PATTERNS)}) to patterns; got {type(sparsity).__name__}.")
    strange = sorted(set(sparsity) - set(PATTERNS))
    if strange:
        raise ProblemError(f"sparsity does not know {', '.join(strange)}; known: {', '.join(PATTERNS)}.")
    return sparsity


def full_pattern(pattern: Any) -> np.ndarray:
    """Convert an array or a SciPy sparse matrix to a dense boolean array."""
    return np.asarray(pattern.toarray() if hasattr(pattern, "toarray") else pattern, dtype=bool)
