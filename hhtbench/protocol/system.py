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
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hhtbench.protocol.arguments import Vector, check_interval, real_array, real_number, real_vector, shown
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.printing import Printed, exact

if TYPE_CHECKING:
    from hhtbench.solution.request import Request
    from hhtbench.solution.result import Solution


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
TAGS = (  # kinds of problems, for choosing among them
    "holonomic",
    "velocity-level",
    "mixed",
    "unconstrained",
    "rheonomic",
    "redundant",
    "singular",
    "stiff",
    "flexible",
    "nonlinear reaction",
    "variable mass",
    "damped",
    "contact",
    "large",
)
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


def _extension() -> Any:
    """The module on states and inputs, imported where a problem has them."""
    return importlib.import_module("hhtbench.protocol.extended")


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


class Motion(NamedTuple):
    """State and multipliers at one time: ``q, v`` (n,), ``lam`` (m,), ``mu`` (p,)."""

    q: Any
    v: Any
    lam: Any
    mu: Any


@dataclass(frozen=True, kw_only=True)
class Scales:
    """Typical sizes of q, v, lam, mu, states x and inputs u that scale errors and drift: one number each or one per
    component.
    """

    q: Any = 1.0
    v: Any = 1.0
    lam: Any = 1.0
    mu: Any = 1.0
    x: Any = 1.0
    u: Any = 1.0


class Unscaled(Scales):
    """Scales of a problem that declares none; a class of its own, which copies and pickles keep."""


UNSCALED = Unscaled()


@dataclass(frozen=True, kw_only=True)
class MinimalCoordinates:
    """The same motion in d independent coordinates ``s``, d the degrees of freedom: an ODE without constraints."""

    system: System  #: its coordinates are ``s``
    embed: Callable[[Any], Any]  #: s (d,) -> q (n,), in ``jax.numpy``
    s0: Any  #: (d,) start: embed(s0) is q0
    u0: Any  #: (d,) ds/dt there


Observable = Callable[[float, Vector, Vector, Vector], Any]


@dataclass(frozen=True, kw_only=True)
class Problem(Printed):
    """A System with a consistent start, an interval and the quantities to measure."""

    name: str
    system: System | NumpySystem
    t_span: tuple[float, float]  #: start and end [s]; an end before the start integrates backward
    q0: Vector  #: (n,) coordinates at the start
    v0: Vector  #: (n,) velocities at the start
    lam_guess: Vector | None = None  #: (m,) starting guess of the multipliers; it picks the root where Q is nonlinear
    mu_guess: Vector | None = None  #: (p,) the same for the velocity constraints
    events: Any = ()  #: :class:`hhtbench.Event`, one or a list: a part of the motion, as impacts are
    x0: Vector | None = None  #: (k,) first-order states at the start, of a system with ``state_rate``
    inputs: Any = ()  #: :class:`hhtbench.Sampled`, one or a list: inputs u that are held between samples
    scales: Scales = UNSCALED
    observables: Mapping[str, Observable] = field(default_factory=dict)  #: name -> fn(t, q, v, lam)
    exact: Callable[[float], Motion] | None = None  #: closed solution
    reference: Mapping[str, Any] | None = None  #: t (k,), q, v (k, n), maybe lam (k, m), mu (k, p), digits
    sketch: Callable[[Vector], Any] | None = None  #: q -> points and lines of a drawing
    minimal: Callable[[], MinimalCoordinates] | None = None  #: makes an unconstrained formulation, if there is one
    tags: tuple[str, ...] = ()  #: some of ``TAGS``: the kinds of problems it belongs to
    good_for: str = ""  #: one sentence: what this problem shows that others do not
    source: str = ""  #: where the equations and values come from

    def __post_init__(self) -> None:
        if isinstance(self.system, type):
            made = self.system.__name__
            raise TypeError(f"system must be an object, not the class {made}; write system={made}(), with its parameters.")
        if not isinstance(self.scales, Scales):
            raise TypeError(f"scales must be a hhtbench.Scales, such as hb.Scales(q=1.0, v=2.0); got {shown(self.scales)}.")
        q0 = real_vector("q0", self.q0)
        if q0.size == 0:
            raise ProblemError("q0 must hold at least one coordinate; got shape (0,).")
        v0 = real_array("v0", self.v0)
        if v0.shape != q0.shape:
            raise ProblemError(f"v0 must have shape {q0.shape}; got {v0.shape}. It has one entry for each of q0.")
        if not isinstance(self.t_span, (tuple, list)) or len(self.t_span) != 2:
            raise ProblemError(f"t_span must be two times (start, end) [s]; got {self.t_span!r}.")
        span = tuple(real_number(f"t_span[{i}]", t, unit=" [s]") for i, t in enumerate(self.t_span))
        check_interval("t_span", *span)
        for name, value in {"q0": q0, "v0": v0, "t_span": span}.items():
            object.__setattr__(self, name, value)
        for name in ("lam_guess", "mu_guess"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, real_vector(name, value))
        further = self.x0 is not None or np.size(self.inputs) or declared(self.system, "state_rate") is not None
        if further and declared(self.system, "layout") is None:
            for name, value in _extension().extended_fields(self).items():
                object.__setattr__(self, name, value)

    @property
    def note_on_scales(self) -> str:
        """Note for messages that errors are unscaled; empty string if the problem declares scales."""
        return "The problem declares no scales: errors are in its own units." if isinstance(self.scales, Unscaled) else ""

    def __repr__(self) -> str:
        (t0, t1), tags = self.t_span, f", {', '.join(self.tags)}" if self.tags else ""
        return f"<Problem {self.name}: {self.q0.size} coordinates, t = {exact(t0)} to {exact(t1)} s{tags}>"

    def starting(self, t_span: tuple[float, float] | None = None, q0: Any = None, v0: Any = None) -> Problem:
        """Return this problem over another interval or from another start, without ``exact``, ``reference`` and
        ``minimal``.
        """
        if t_span is None and q0 is None and v0 is None:
            return self
        n = self.q0.size
        given: dict[str, Any] = {name: real_vector(name, x, n) for name, x in (("q0", q0), ("v0", v0)) if x is not None}
        given |= {} if t_span is None else {"t_span": t_span}
        return dataclasses.replace(self, **given, exact=None, reference=None, minimal=None)

    def with_system(self, system: System | NumpySystem) -> Problem:
        """Return this problem with another system, without guesses of multipliers and what belongs to one motion."""
        none: dict[str, Any] = dict.fromkeys(("lam_guess", "mu_guess", "exact", "reference", "minimal"))
        layout = declared(self.system, "layout")
        if layout is not None and declared(system, "layout") is None:
            system = _extension().extended(system, layout)
        return dataclasses.replace(self, system=system, **none)

    @property
    def samples(self) -> tuple[Any, ...]:
        """Periodic changes of the state by which the inputs are sampled."""
        return () if not np.size(self.inputs) else _extension().samples_of(self)


class Solver(Protocol):
    """Interface of a solver: ``name``, ``accepts`` and ``solve``.

    Optional: ``with_events(events)`` returns the solver with event functions; ``warm_up(problem, request)`` compiles;
    ``count(problem, request)`` returns the Counters of an untimed run; ``evaluates(problem)`` returns what one residual
    evaluation is ("residual" or "acceleration") and of which problem.  ``heeds_tolerances = True`` states that the solver
    controls its error by the tolerances: two runs that agree then show the error even if they took the same steps.
    """

    name: str

    def accepts(self, problem: Problem, request: Request) -> str | None:
        """Return the reason why this solver cannot take the problem or request, or None; calls no function of the system."""

    def solve(self, problem: Problem, request: Request) -> Solution:
        """Integrate; numerical failures end in ``Solution.status``, never in an exception."""
