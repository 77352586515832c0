"""``Loops``: the compiled loops with the functions of one system, their memory, and conversion from and to ``State``."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from itertools import compress
from typing import Any, NamedTuple

import numpy as np

from hhtbench.lowering.dynamics.callbacks import Callbacks
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.errors import NonFiniteValue, ProblemError
from hhtbench.protocol.events import Event
from hhtbench.solution.counting import Work
from solvers._start import Guesses, PhasePoint
from solvers.hht.control.first_step import plan_first_step
from solvers.hht.control.tolerances import Tolerances
from solvers.hht.equations.known import Layout
from solvers.hht.events.functions import EventFunctions
from solvers.hht.run.branches import Stepped
from solvers.hht.run.in_python import Codes, python_codes
from solvers.hht.run.march import march, remake
from solvers.hht.step.attempt import LEAP
from solvers.hht.step.state import ControlMemory, Factorised, State
from solvers.kernel import memory as mem
from solvers.kernel.acceleration import start
from solvers.kernel.full import GOOD_START
from solvers.kernel.memory import HIGHEST, Memory, integer_view, view

UNLIMITED = 2**62
OF_STATE = {  # arrays of a State, and of its ControlMemory, with their sections of the memory
    "q": mem.Q, "v": mem.V, "a": mem.A, "f": mem.F, "lam": mem.LAM, "mu": mem.MU, "vdot": mem.VDOT,
    "lam_before": mem.LAM_BEFORE, "lam_applied": mem.LAM_APPLIED, "inverse_mass": mem.INVERSE_MASS, "unknowns": mem.X_LAST,
}  # fmt: skip
OF_CONTROL = {
    "earlier": mem.BEFORE, "acceleration": mem.ACCELERATION, "velocity_reaction": mem.REACTION_K, "q_first": mem.Q_FIRST,
    "q_before": mem.Q_BEFORE,
}  # fmt: skip


class Loops:
    """The loops over steps with the functions of ``engine``, which evaluate the functions of ``events`` in every step."""

    def __init__(self, engine: Stepped, events: Sequence[Event]) -> None:
        self.functions, self.work = engine.functions, engine.work
        self._points, method, functions = engine.points, engine.method, engine.functions
        self.callbacks = functions.callbacks or Callbacks()
        self.callbacks.check = self.work.check_time
        self.events = EventFunctions(events, functions, self.callbacks)
        self.held: State | None = None  #: the state in the memory
        self.nonfinite: NonFiniteValue | None = None  #: the last value in the last call, where it is known
        self._allowed: Tolerances | None = None  # the tolerances in the memory
        self._stops_early = False  # whether these are coarse enough for (H35)
        self._outside = functions.analysis.outside()
        self.z = z = functions.memory(len(self.events.events), self.events.samples)
        c, o = method.coefficients, functions.newton
        view(z, mem.START_BOUNDS)[:] = GOOD_START
        leap = LEAP if c.both_levels else math.inf  # with one level only v does not match q
        view(z, mem.CONSTANTS)[:] = [c.alpha, c.beta, c.gamma, *(getattr(o, name) for name in mem.NEWTON_CONSTANTS), leap]
        z.i[mem.RESCALE_A], z.i[mem.TRAPEZOIDAL] = method.rescale_a, method.start == "trapezoidal"
        z.i[mem.MAX_ITERATIONS] = o.max_iterations
        z.i[mem.WATCHING] = bool(self.events.events)
        codes = functions.codes(self.callbacks) | python_codes(engine, self.callbacks) | functions.level_codes()
        if z.i[mem.KIND] == mem.KIND_CALLBACK and self._outside is not None:
            codes |= self._outside.codes(self.callbacks)
        self._put(codes)
        self.events.fill(z)
        self._given = np.flatnonzero(z.w)  # constants, which a new run finds again: all else begins as zero
        self._constants = z.w[self._given]
        kept, self._parts = state_sections(z)
        self._state, self._number, self._variable = z.w[kept], self.section(mem.NUMBER), bool(z.i[mem.VARIABLE])
        self._row = row_places(z)
        #: by entry; not of a method, since Python frees the memory of a cycle late
        self._entry = lru_cache(partial(_bound, z, engine.control, engine.plain))
        self.has_level = bool(z.i[mem.C_KKT])  #: the acceleration level, of full matrices
        looks_closer = engine.structure.constrained and not self.has_level  # acceleration levels are Python's
        self.call_python = bool(self.events.events or engine.plain or z.i[mem.CALLS_PYTHON] or looks_closer)
        self._place = np.split(self.section(mem.PLACE), [1, 1 + engine.structure.n])
        self._multipliers = [self.section(name) for name in (mem.LAM, mem.MU)]
        self._counts = integer_view(z, mem.COUNTED)

    def again(self, work: Work) -> None:
        """Reset for another run."""
        self.work, self.callbacks.check = work, work.check_time
        self.held = self.nonfinite = self._allowed = None
        self.callbacks.take_cause()
        self.callbacks.take_nonfinite()
        self.z.w.fill(0.0)
        self.z.w[self._given] = self._constants
        self._counts.fill(0)

    @property
    def nbytes(self) -> int:
        """Bytes of the memory, and of the factors kept outside."""
        outside = 0 if self._outside is None else self._outside.nbytes
        return int(self.z.w.nbytes + self.z.i.nbytes + outside)

    def section(self, name: int) -> Vector:
        """A section of the memory, as a view."""
        section: Vector = view(self.z, name)
        return section

    def allow(self, tolerances: Tolerances) -> None:
        """Use ``tolerances`` for the following steps."""
        if self._allowed is not tolerances:
            self.section(mem.RTOL)[:], self.section(mem.ATOL)[:] = tolerances.rtol, tolerances.atol
            o, self._allowed = self.functions.newton, tolerances
            self._stops_early = o.remaining > 0.0 and tolerances.finest >= o.finest

    def load(self, state: State, values: Vector | None, *, controlled: bool, fallback: bool) -> None:
        """Load ``state`` into the memory, remake the factorisation it holds, and set event ``values`` (None: keep them).

        ``fallback``: a failure of Newton's iteration may be due to declared derivatives.

        Raises
        ------
        ProblemError
            An array of the state has not the shape that this system with these options has.
        """
        self.raise_noted()
        z = self.z
        if controlled and not z.i[mem.CODE + 2 * mem.FUNCTIONS.index("raw")]:
            self._put(self.functions.error_codes(self.callbacks))
        if self.held is not state:
            if misfits(state, self.functions.layout, self.functions.given[0]):
                raise ProblemError("the state is none of this system with these options: its arrays are of other lengths.")
            self.held, ended = None, mem.CONVERGED
            if state.factorised is not None:
                before = self.work.tally.copy()
                ended = self.call(remake, state.factorised.at)
                self.work.tally.clear()  # that work was counted before
                self.work.tally.update(before)
            self._fill(state if ended == mem.CONVERGED else replace(state, factorised=None))
            self.held = state
        self.ready(controlled=controlled, fallback=fallback)
        if values is not None:
            self.section(mem.EVENT_VALUES)[:] = values
        if self.events.events:
            integer_view(z, mem.EVENT_CODE)[:] = self.events.codes()

    def start(self, place: PhasePoint, guesses: Guesses) -> State | None:
        """First state at ``place`` with multipliers near ``guesses``; None if this is not plainly a good start."""
        self.held, (t, q, v) = None, self._place
        t[:], q[:], v[:] = place.t, place.q, place.v
        for section, guess in zip(self._multipliers, guesses, strict=True):
            section[:] = 0.0 if guess is None else guess
        return self.store(controlled=False) if self._entry(start)() else None

    def row(self, state: State) -> Vector:
        """Row [t, 0, q, v, a, lam, lam, mu] of a state that is no end of a step."""
        if self.held is state:
            return self.z.w.take(self._row)
        return np.concatenate(([state.t, 0.0], state.q, state.v, state.a, state.lam, state.lam, state.mu))

    def store(self, *, controlled: bool) -> State:
        """The state in the memory, as a State."""
        kept = KeptState(self._state.copy(), self._parts, self._variable, controlled)
        t, h, size_q, size_v, _, _ = self._number.tolist()
        known = {"t": t, "h": h or None, "size_q": size_q, "size_v": size_v, "controlled": controlled, "_read": kept.read}
        self.held = State.of(known)
        return self.held

    def call(self, entry: Any, *arguments: Any) -> int:
        """Call one of the loops; an exception in a Python callback is raised again."""
        result = self.call_noting(entry, *arguments)
        self.raise_noted()
        return result

    def call_noting(self, entry: Any, *arguments: Any) -> int:
        """Call one of the loops and count its work; an exception in a Python callback stays noted."""
        limit, spent = self.work.max_evaluations, self.work.tally
        limited = limit is not None and self._points
        self.z.i[mem.EVALUATIONS] = limit - spent["residual_evaluations"] if limited else UNLIMITED  # type: ignore[operator]
        if entry is march or self.call_python:
            with self.callbacks:
                result = self._entry(entry)(*arguments)
        else:
            result = self._entry(entry)(*arguments)
        nonfinite = self.callbacks.take_nonfinite()
        self.nonfinite = nonfinite[-1] if nonfinite else None
        if not self._points:
            self._counts[mem.RESIDUALS], self._counts[mem.NONFINITES] = 0, len(nonfinite)
        self.count()
        return result or 0

    def count(self) -> None:
        """Add the loops' counts since the last call to the work."""
        tally, counts = self.work.tally, self._counts.tolist()
        for name, count in compress(zip(mem.COUNTS, counts, strict=True), counts):
            tally[name] += count
        self._counts.fill(0)

    def ready(self, *, controlled: bool, fallback: bool) -> None:
        """Set the flags of the following steps, with unlimited evaluations."""
        z = self.z
        z.i[mem.FALLBACK], z.i[mem.CONTROLLED], z.i[mem.EVALUATIONS] = fallback, controlled, UNLIMITED
        z.i[mem.STOPS_EARLY] = controlled and self._stops_early

    def raise_noted(self) -> None:
        """Raise an exception or interrupt noted during the loops; the steps before it remain valid."""
        if self.callbacks.cause is not None:
            raise self.callbacks.take_cause()  # type: ignore[misc] # it is there

    def _put(self, codes: Codes) -> None:
        for name, pair in codes.items():
            at = mem.CODE + 2 * mem.FUNCTIONS.index(name)
            self.z.i[at : at + 2] = pair

    def _fill(self, state: State) -> None:
        """Write ``state``, already checked, into the memory; its factorisation, if any, is in the first place."""
        earlier, memory, made = state.earlier, state.memory, state.factorised
        known = 0 if state.unknowns is None else 1 + (0 if earlier is None else len(earlier))
        lu = -1.0 if made is None else 0.0
        self.section(mem.NUMBER)[:] = state.t, state.h or 0.0, state.size_q, state.size_v, known, lu
        if made is not None:
            record = self.section(mem.RECORD)
            record[mem.RATE], record[mem.USES], record[mem.KEPT_COST] = made.rate, made.uses, made.cost
        if memory is not None:
            error = -1.0 if memory.error is None else memory.error
            has_reaction, bound = memory.velocity_reaction is not None, math.inf if memory.bound is None else memory.bound
            numbers = memory.h_next, memory.last, error, has_reaction, memory.last_but_one, bound
            self.section(mem.CONTROL)[:] = numbers
        for owner, sections in ((state, OF_STATE), (memory, OF_CONTROL)):
            for name, section in sections.items():
                values = getattr(owner, name, None)
                if values is not None:
                    self.section(section)[:] = values.ravel()
        if earlier is not None:
            self.section(mem.X_EARLIER)[: earlier.size] = earlier.ravel()
            self.section(mem.H_EARLIER)[: len(earlier)] = state.lengths


def _bound(z: Memory, control: Any, plain: bool, entry: Any) -> Callable[..., Any]:
    """``entry`` with its first arguments bound: the memory and, where it takes them, the controller's options."""
    first = (z, control) if entry in (march, plan_first_step) else (z,)
    return partial(in_plain_python, entry, *first) if plain else entry.following(*first)


def in_plain_python(entry: Any, *arguments: Any) -> Any:
    """Run ``entry`` as plain Python, without floating-point warnings, as compiled code has none."""
    with np.errstate(all="ignore"):
        return entry.function(*arguments)


Parts = dict[int, slice]  # sections of the state by name


class KeptState(NamedTuple):
    """A copy of a state's part of the memory; fields of State are read from it on demand."""

    numbers: Vector
    parts: Parts  #: slice of each section in ``numbers``
    variable: bool  #: True if the mass varies
    controlled: bool

    def part(self, section: int) -> Vector:
        """Numbers of a section."""
        return self.numbers[self.parts[section]]

    def read(self, name: str) -> Any:
        """Value of the field ``name`` of :class:`State`."""
        known, lu = self.part(mem.NUMBER)[mem.KNOWN : mem.FACTOR + 1].tolist()
        if name == "memory":
            return self._memory() if self.controlled else None
        if name == "factorised":
            return None if lu < 0.0 else self._factorised(int(lu))
        if name == "earlier":
            return self.part(mem.X_EARLIER).reshape(HIGHEST, -1)[: int(known) - 1] if known > 1.0 else None
        if name == "lengths":
            return self.part(mem.H_EARLIER)[: int(known) - 1] if known > 1.0 else None
        found = self.part(OF_STATE[name])
        if name == "inverse_mass":
            n = self.part(mem.Q).size
            return found.reshape(n, n) if self.variable else None
        return None if name == "unknowns" and not known else found

    def _memory(self) -> ControlMemory:
        h_next, last, error, has_reaction, last_but_one, bound = self.part(mem.CONTROL).tolist()
        return ControlMemory(
            h_next=h_next,
            last=last,
            last_but_one=last_but_one,
            q_first=self.part(mem.Q_FIRST),
            q_before=self.part(mem.Q_BEFORE),
            earlier=self.part(mem.BEFORE),
            acceleration=self.part(mem.ACCELERATION),
            velocity_reaction=self.part(mem.REACTION_K) if has_reaction else None,
            error=None if error < 0.0 else error,
            bound=bound if math.isfinite(bound) else None,
        )

    def _factorised(self, lu: int) -> Factorised:
        rate, uses, _, cost = self.part(mem.RECORD + lu)[mem.RATE : mem.KEPT_COST + 1].tolist()
        return Factorised(at=self.part(mem.MADE_AT + lu), rate=rate, uses=int(uses), cost=cost)


def state_sections(z: Memory) -> tuple[slice, Parts]:
    """Slice of the state in the memory's floats, and the slices of its sections within it."""
    pairs = (mem.RECORD, mem.RECORD + 1, mem.MADE_AT, mem.MADE_AT + 1)
    sections = (mem.NUMBER, *OF_STATE.values(), mem.X_EARLIER, mem.H_EARLIER, mem.CONTROL, *OF_CONTROL.values(), *pairs)
    bounds = {section: z.i[2 * section : 2 * section + 2].tolist() for section in sections}
    first = min(start for start, _ in bounds.values())
    parts = {section: slice(start - first, start - first + size) for section, (start, size) in bounds.items()}
    return slice(first, first + max(part.stop for part in parts.values())), parts


def row_places(z: Memory) -> Any:
    """Indices in the memory's floats of the row of :meth:`Loops.row`; H is 0 before the first step."""
    bounds = [z.i[2 * section : 2 * section + 2].tolist() for section in (mem.Q, mem.V, mem.A, mem.LAM, mem.LAM, mem.MU)]
    number = int(z.i[2 * mem.NUMBER])
    return np.concatenate([[number + mem.T, number + mem.H], *(start + np.arange(size) for start, size in bounds)])


def misfits(state: State, layout: Layout, given: int) -> list[str]:
    """Texts on arrays of ``state`` that belong to another system or other options; ``given``: numbers of a step."""
    s, size = layout.structure, layout.size
    known = 0 if state.earlier is None else min(state.earlier.size // size, HIGHEST)
    vectors = dict.fromkeys(("q", "v", "a", "f", "vdot"), (s.n,)) | {"lam": (s.m,), "mu": (s.p,)}
    vectors |= dict.fromkeys(("lam_before", "lam_applied"), (s.m if layout.extrapolated else 0,))
    matrices = {"inverse_mass": (s.n, s.n), "unknowns": (size,), "earlier": (known, size)}
    vectors |= {"lengths": (known,)}
    found = misshapen(state, vectors | matrices) + misshapen(state.memory, dict.fromkeys(OF_CONTROL, (s.n,)))
    found += misshapen(state.factorised, {"at": (2 * size + 1 + given,)})
    return found + [f"the mass is {s.mass}"] * ((state.inverse_mass is None) == (s.mass == "variable"))


def misshapen(owner: Any, shapes: dict[str, tuple[int, ...]]) -> list[str]:
    """Texts on arrays of ``owner`` whose shapes are not ``shapes``; None is accepted."""
    found = []
    for name, shape in shapes.items():
        value = getattr(owner, name, None)
        if value is not None and (value.shape != shape or value.dtype != np.float64):
            found.append(f"{type(owner).__name__}.{name} must have shape {shape}; got {value.dtype} {value.shape}")
    return found
