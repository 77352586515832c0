"""Events as the user declares them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hhtbench.protocol.arguments import positive_integer, real_number
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.system import NumpySystem, Signature, System, accepts

STATE = Signature(("t", "q", "v"), ("",))
MULTIPLIERS = Signature(("t", "q", "v", "lam", "mu"), ("",))


@dataclass(frozen=True)
class Event:
    """A zero of a function of the state, to be found along the motion.

    The function is sampled at the end of each step and at ``samples`` points within it; a change of sign between two
    samples is an event.  Two zeros in one step are found if a sample lies between them, a zero without a change of sign
    only if a sample hits it.  A motion that begins on a zero has no event there, unless the event has a change and a
    direction in which the motion sets out; a motion that ends on a zero has one.  The function may be discontinuous.

    If the event neither stops the integration nor changes the state, its time is a zero along the dense output, and its
    state that of the dense output, projected onto both levels of the constraints, (H47).  Otherwise the step is repeated
    with the length at which the function is zero (or has just crossed zero) at the step's own end, to the last bits of
    time: the state there is as accurate as at every step.

    Parameters
    ----------
    function
        ``(t, q, v)`` with q, v (n,) to a number.  One that JAX can trace and that refers to nothing that changes becomes
        machine code; any other is called back, at some ten microseconds a sample.
    direction
        1: only zeros with a rising function, along the integration, so also where time runs backward; -1: falling; 0: both.
    terminal
        True: the first occurrence stops the integration; a whole number: so does that one, and later ones where
        stepping goes on.
    change
        ``(t, q, v)`` to a new ``(q, v)``, for example an impact.  It is projected onto both levels of the constraints in
        the norm of the mass matrix, (H20), and the integration restarts there with new multipliers and step control.
        Several events at one time change the state in the order in which they were given, and again where the change by
        one leads back to the zero of another, as between three bodies that collide together.  A change that reverses or
        stops the function leaves the motion on the side of the zero from which it came; any other lets it pass.
        Changes that pile up at one time, as those of a ball that comes to rest, end the run as ``time_resolution``: end
        it earlier by ``terminal=N``, and continue with a constraint instead of the contact.
    name
        For messages; by default the function's own name.
    samples
        Points within a step at which the function is evaluated; limit the step by ``max_step`` where nothing else does.
    restitution
        From 0 to 1: the event is an impact on the zero of a distance, a function of t and q.  Its rate after the impact is
        -restitution times the rate before; the impulse acts along the gradient of the distance and on the constraints.
        Impacts at one time act together: the rates of all distances that close are reversed at once, and none pulls.
    then
        The :class:`~hhtbench.System` of the motion after the event: constraints begin, end or change.  Velocities are
        projected onto its constraints in the norm of the mass matrix, an impact without rebound.  With ``restitution`` the
        motion goes on with it once its rebounds follow one another within the resolution of time.  A ``change`` comes
        before; a ``terminal`` event ends the run in the system before.
    during
        The system, or a list of them, in whose motion the event is looked for; None: any.
    period, first
        Set by :meth:`every`.

    A function ``(t, q, v, lam, mu)`` also takes the multipliers of the acceleration level: a contact ends where its force
    does.  Such an event with a direction and ``then`` happens at once where a phase begins beyond its zero.
    """

    function: Callable[..., Any]
    direction: int = 0
    terminal: bool | int = False
    change: Callable[..., Any] | None = None
    name: str = ""
    samples: int = 4
    restitution: float | None = None
    then: System | NumpySystem | None = None
    during: Any = None
    period: float = 0.0
    first: float = 0.0

    @classmethod
    def every(
        cls,
        period: float,
        change: Callable[..., Any],
        *,
        name: str = "sample",
        first: float = 0.0,
        terminal: bool | int = False,
    ) -> Event:
        """An event ``first`` seconds after the start of the interval and every ``period`` [s] after it.

        ``change`` as of any event.  No step passes such a time; :func:`hhtbench.solve` takes it with every solver, at
        tolerances.  For controllers that sample see :class:`hhtbench.Sampled`.
        """
        if not real_number("the period of an event", period, unit=" [s]") > 0.0:
            raise ProblemError(f"the period of an event must be above 0 s; got {period}.")
        if real_number("first of a periodic event", first, unit=" [s]") < 0.0:
            raise ProblemError(f"first of a periodic event must be at least 0 s; got {first}.")
        return cls(_never, change=change, name=name, terminal=terminal, period=float(period), first=float(first))

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise TypeError(f"an event's function must be callable as (t, q, v); got {type(self.function).__name__}.")
        if self.change is not None and not callable(self.change):
            raise TypeError(f"an event's change must be callable as (t, q, v); got {type(self.change).__name__}.")
        if isinstance(self.direction, bool) or self.direction not in (-1, 0, 1):
            raise ProblemError(f"an event's direction must be -1 (falling), 0 (both) or 1 (rising); got {self.direction!r}.")
        if not isinstance(self.terminal, (bool, np.bool_)):
            positive_integer("an event's terminal (True, False, or the number of the occurrence)", self.terminal)
        if not isinstance(self.name, str):
            raise TypeError(f"an event's name must be a string; got {self.name!r}.")
        positive_integer("an event's samples", self.samples)
        if self.restitution is not None and not 0.0 <= real_number("an event's restitution", self.restitution) <= 1.0:
            raise ProblemError(f"an event's restitution must be from 0 to 1; got {self.restitution}.")
        if self.restitution is not None and self.change is not None:
            raise ProblemError("an event has a restitution or a change, not both; change returns the state after an impact.")
        if self.restitution is not None and self.takes_multipliers:
            raise ProblemError("an event with a restitution is a distance, a function of (t, q, v), without multipliers.")
        for name, given in (("then", self.then), ("during", self.during)):
            for system in given if isinstance(given, (list, tuple)) and name == "during" else (given,):
                if system is not None and not isinstance(system, (System, NumpySystem)):
                    expected = "must be a System, such as problem.system"
                    raise TypeError(f"an event's {name} {expected}; got {type(system).__name__}.")

    @property
    def acts(self) -> bool:
        """True if it changes the state or the system."""
        return self.change is not None or self.restitution is not None or self.then is not None

    @property
    def takes_multipliers(self) -> bool:
        """True if its function is one of (t, q, v, lam, mu)."""
        return accepts(self.function, MULTIPLIERS) and not accepts(self.function, STATE)

    @property
    def between_steps(self) -> bool:
        """True if no loop of a solver knows it: it is found between the steps, as those of any solver."""
        declared = self.period or self.restitution is not None or self.then is not None or self.during is not None
        return bool(declared) or self.takes_multipliers

    def happens_in(self, system: Any) -> bool:
        """True if it is looked for in the motion of ``system``."""
        listed = self.during if isinstance(self.during, (list, tuple)) else [self.during]
        inner = getattr(system, "inner", system)  # of a system with states or inputs
        return self.during is None or any(one is system or one is inner for one in listed)

    def ends(self, count: int) -> bool:
        """True if occurrence number ``count`` stops the integration."""
        return bool(self.terminal) and count >= int(self.terminal)


def _never(t: Any, q: Any, v: Any) -> float:
    """Event function without a zero."""
    return 1.0


def make_events(given: Any) -> tuple[Event, ...]:
    """Events from the user's argument: None, one, or several; each an :class:`Event` or a plain callable.

    SciPy's attributes ``direction`` and ``terminal`` of a plain callable are used; the callable is not modified.

    Raises
    ------
    ProblemError, TypeError
        One is neither callable nor an Event, or its attributes are out of range.
    """
    listed = [] if given is None else list(given) if isinstance(given, (list, tuple)) else [given]
    return tuple(_event(f"events[{i}]", one) for i, one in enumerate(listed))


def _event(place: str, given: Any) -> Event:
    if not isinstance(given, Event):
        if not callable(given):
            raise TypeError(f"{place} must be an Event or a callable (t, q, v); got {type(given).__name__}.")
        direction = np.sign(getattr(given, "direction", 0))
        given = Event(given, direction=int(direction), terminal=getattr(given, "terminal", False) or False)
    own = getattr(given.function, "__name__", "<lambda>")
    return given if given.name else replace(given, name=place if own == "<lambda>" else own)
