"""A Problem: a System with a start, an interval and what to measure; the interface of solvers."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from hhtbench.protocol.arguments import Vector, check_interval, real_array, real_number, real_vector, shown
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.printing import Printed, exact
from hhtbench.protocol.scales import UNSCALED, Scales, Unscaled
from hhtbench.protocol.system import NumpySystem, System, declared

if TYPE_CHECKING:
    from hhtbench.solution.request import Request
    from hhtbench.solution.result import Solution

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


class Motion(NamedTuple):
    """State and multipliers at one time: ``q, v`` (n,), ``lam`` (m,), ``mu`` (p,)."""

    q: Any
    v: Any
    lam: Any
    mu: Any


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
        if further or declared(self.system, "layout") is not None:
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
        if declared(self.system, "layout") is not None:
            given: dict[str, Any] = _extension().restart(self, q0, v0)
        else:
            given = {name: real_vector(name, x, n) for name, x in (("q0", q0), ("v0", v0)) if x is not None}
        given |= {} if t_span is None else {"t_span": t_span}
        return dataclasses.replace(self, **given, exact=None, reference=None, minimal=None)

    def with_system(self, system: System | NumpySystem) -> Problem:
        """Return this problem with another system, without guesses of multipliers and what belongs to one motion."""
        none: dict[str, Any] = dict.fromkeys(("lam_guess", "mu_guess", "exact", "reference", "minimal"))
        layout = declared(self.system, "layout")
        if layout is not None and declared(system, "layout") is None:
            system = importlib.import_module("hhtbench.protocol.extended").extended(system, layout)
        return dataclasses.replace(self, system=system, **none)

    @property
    def samples(self) -> tuple[Any, ...]:
        """Periodic events by which the inputs are sampled."""
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


def _extension() -> Any:
    """The module on states and inputs, imported where a problem has some."""
    return importlib.import_module("hhtbench.protocol.extension")
