"""Whether what a checkpoint holds can be a state of this system's steps: nothing else is computed with."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from hhtbench.errors import ProblemError
from solvers.hht.blocks import Order
from solvers.hht.engine import HostEngine, largest
from solvers.hht.laws import HIGHEST
from solvers.hht.layout import Layout
from solvers.hht.linear import DenseFactor, Factor, InverseFactor
from solvers.hht.sparse import Band, BandFactor, Splu, SpluFactor
from solvers.hht.state import State, Step
from solvers.hht.stepping import Constant, Standing
from solvers.hht.watch import Course, Watch

SHORTEST, LONGEST = 1e-150, 1e150  # [s] of a step: squares of what is beyond, and of their ratios, leave the numbers
AGREE = 1e-6  # of q and v: steps with the kept factorisation and with a fresh one differ by what Newton's iteration leaves
SAME = (
    1e3  # the maps of a kept factorisation, with which Newton's iteration measures, give changes of the size of fresh ones
)


def check(standing: Standing, engine: HostEngine, events: int) -> None:
    """Raise ProblemError unless ``standing`` is a legal state of steps by ``engine`` with as many events."""
    s, layout = standing, engine.layout
    wrong = _misshapen(s, layout, events) or _misfits(s, layout.structure.mass, events)
    if not wrong and s.state.factor is not None:
        wrong = _unfit_factor(s.state.factor, s.state.t, engine)
    if wrong:
        raise ProblemError(f"the checkpoint does not fit this system: {wrong[0]}.")


def check_factor(state: State, engine: HostEngine) -> None:
    """Raise ProblemError where the kept factorisation makes another step of its length than a fresh one does.

    From accelerations and multipliers of zero, so that each must find them.  ``engine`` serves for nothing else.
    """
    kept = state.factor
    if kept is None:
        return
    blank = replace(state, unknowns=np.zeros(engine.layout.size), earlier=None)
    course = Course(engine=engine, advance=Constant(engine, kept.h))
    stop = math.copysign(math.inf, kept.h)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            theirs, ours = (course.next(replace(blank, factor=factor), Watch(), stop) for factor in (kept, None))
            wrong = _disagree(kept, getattr(theirs, "step", None), getattr(ours, "step", None), engine.layout)
    except Exception:  # noqa: BLE001 - of the user's functions, where they are not defined: the steps themselves will tell
        return
    if wrong:
        raise ProblemError("the checkpoint does not fit this system: State.factor is no factorisation of its matrix.")


def _disagree(kept: Factor, theirs: Step | None, ours: Step | None, layout: Layout) -> bool:
    """Whether a step with the ``kept`` factorisation, ``theirs``, is not what it is with a fresh one, ``ours``."""
    if theirs is None or ours is None:
        return theirs is not None  # the same remedies serve both: a step that only the kept one makes is none
    n, fresh = layout.structure.n, ours.state.factor
    sizes = ours.state.size_q, ours.state.size_v
    apart = largest(theirs.state.q - ours.state.q), largest(theirs.state.v - ours.state.v)
    if not all(difference <= AGREE * size for difference, size in zip(apart, sizes, strict=True)):
        return True
    if fresh is None:  # a step too short for Newton's iteration
        return False
    probe = np.random.default_rng(0).standard_normal(layout.size)
    changes = zip(
        kept.largest(probe, n), fresh.largest(probe, n), strict=True
    )  # not solved: where it is singular all differ
    alike = all(a <= SAME * b and b <= SAME * a for a, b in changes)
    quiet = all(a <= SAME * b + AGREE * size for a, b, size in zip(kept.noise, fresh.noise, sizes, strict=True))
    return not (alike and quiet)


def _misshapen(s: Standing, layout: Layout, events: int) -> list[str]:
    """Arrays of a wrong shape, in words."""
    n, m, p, size = layout.structure.n, layout.structure.m, layout.structure.p, layout.size
    state, rows = s.state, s.last.t.size
    known = 0 if state.earlier is None else min(state.earlier.size // size, HIGHEST)
    wanted: list[tuple[Any, dict[str, Any]]] = [
        (s.place, {"q": (n,), "v": (n,)}),
        (state, dict.fromkeys(("q", "v", "a", "f", "vdot"), (n,)) | {"lam": (m,), "mu": (p,)}),
        (state, {"inverse_mass": (n, n), "unknowns": (size,), "earlier": (known, size)}),
        (state.memory, dict.fromkeys(("earlier", "acceleration", "velocity_reaction"), (n,))),
        (s.tolerances, {"rtol": (2 * n,), "atol": (2 * n,)}),
        (s.watch, {"values": (events,)}),
        (s.last, {"t": (max(rows, 1),), "q": (rows, n), "v": (rows, n)}),
        *((found, {"q": (n,), "v": (n,)}) for found in s.occurrences),
    ]
    found = []
    for owner, shapes in wanted:
        for name, shape in shapes.items() if owner is not None else ():
            value = getattr(owner, name)
            if value is not None and (value.shape != shape or value.dtype != np.float64):
                found.append(f"{type(owner).__name__}.{name} must have shape {shape}; got {value.dtype} {value.shape}")
    return found


def _misfits(s: Standing, mass: str, events: int) -> list[str]:
    """What contradicts something else, in words."""
    state, memory, t = s.state, s.state.memory, s.last.t
    named = {
        "either a step or tolerances are needed": (s.step is None) == (s.tolerances is None),
        "a step must not be zero": s.step == 0.0 or not (state.h is None or _is_length(state.h, state.t)),
        "the direction of time must be 1, -1 or 0": s.direction not in (-1.0, 0.0, 1.0),
        f"the mass is {mass}": (state.inverse_mass is None) == (mass == "variable"),
        "sizes must not be negative": min(state.size_q, state.size_v) < 0,
        "the next step must be positive": memory is not None and not memory.h_next > 0.0,
        "tolerances must not be negative": s.tolerances is not None
        and min(s.tolerances.rtol.min(), s.tolerances.atol.min()) < 0.0,
        f"there are {events} events": len(s.watch.counts) != events
        or not all(0 <= i < events for i in (*s.watch.changed, *(found.index for found in s.occurrences))),
        "the last step must end at the state": not t.size or t[-1] != state.t,
    }
    return [text for text, broken in named.items() if broken]


def _is_length(h: float, t: float) -> bool:
    """Whether a step of ``h`` [s] can have ended at ``t``."""
    return max(float(np.spacing(abs(t))) / 2, SHORTEST) <= abs(h) <= LONGEST


def _unfit_factor(factor: Factor, t: float, engine: HostEngine) -> list[str]:
    """Shapes and places of a factorisation: compiled loops go by them and look at no bound."""
    rows, size, maps = 2 * engine.structure.n, engine.layout.size, factor.maps
    fits = _is_length(factor.h, t) and len(factor.noise) == 2 and factor.uses >= 0 and min(factor.rate, *factor.noise) >= 0.0
    fits &= maps.shape == (rows, size) and maps.dtype == np.float64
    if hasattr(maps, "indptr"):
        fits &= maps.indptr.dtype == maps.indices.dtype == np.int32
    if isinstance(factor, DenseFactor):
        fits &= factor.lu.shape == (size, size) and factor.lu.dtype == np.float64
        fits &= _are_places(factor.pivots, (size,), size, np.int32)
    elif isinstance(factor, InverseFactor):
        fits &= factor.inverse.shape == (size, size) and factor.inverse.dtype == np.float64
    elif isinstance(factor, SpluFactor):
        fits &= factor.matrix.shape == (size, size)
    elif isinstance(factor, BandFactor):
        fits &= hasattr(maps, "indptr") and _is_order(factor.order, size) and _is_band(factor, size)
    linear: Any = engine.choice.linear
    band = getattr(linear, "band", linear)
    if fits and isinstance(band, Band | Splu) and not isinstance(factor, DenseFactor):
        fits &= _is_of(factor, band)
    return [] if fits else [f"State.factor is no {type(factor).__name__} of {size} unknowns"]


def _is_of(factor: Factor, band: Band | Splu) -> bool:
    """Whether the entries are those of the analysis in use, place by place."""
    if not hasattr(factor.maps, "indptr"):
        return False
    pairs: list[tuple[Any, Any]] = [(factor.maps.indptr, band.maps.starts), (factor.maps.indices, band.maps.columns)]
    if isinstance(factor, BandFactor) and isinstance(band, Band):
        theirs, c = factor.order, factor.couplings
        pairs += [(theirs.rows, band.order.rows), (theirs.columns, band.order.columns), (theirs.blocks, band.order.blocks)]
        pairs += [(c.starts, band.starts), (c.places, band.coupled)]
    return all(np.array_equal(a, b) for a, b in pairs)


def _are_places(values: Any, shape: tuple[int, ...], size: int, dtype: Any = np.int64) -> bool:
    """Whole numbers of the type ``dtype`` from 0 to before ``size``."""
    return values.shape == shape and values.dtype == dtype and bool(np.all((values >= 0) & (values < size)))


def _is_order(order: Order, size: int) -> bool:
    """Two permutations, and blocks that follow one another."""
    everything, blocks = np.arange(size), order.blocks
    for places in (order.rows, order.columns):
        if not _are_places(places, (size,), size) or not np.array_equal(np.sort(places), everything):
            return False
    if not _are_places(blocks, (blocks.size // 4, 4), size + 1):
        return False
    start, count, lower, upper = blocks.T
    ends = np.concatenate([[0], np.cumsum(count)])
    return bool(np.array_equal(start, ends[:-1]) and ends[-1] == size and np.all((lower < count) & (upper < count)))


def _is_band(factor: BandFactor, size: int) -> bool:
    """Storage, pivots and couplings within the blocks of their order."""
    order, c, pivots = factor.order, factor.couplings, factor.pivots
    if (
        not _are_places(pivots, (size,), size)
        or factor.storage.shape != (order.storage,)
        or factor.storage.dtype != np.float64
    ):
        return False
    start, count, lower, _ = (np.repeat(column, order.blocks[:, 1]) for column in order.blocks.T)
    inside = np.all(pivots <= np.minimum(lower, start + count - 1 - np.arange(size)))
    if not inside or not _are_places(c.starts, (size + 1,), c.places.size + 1) or np.any(np.diff(c.starts) < 0):
        return False
    earlier = np.repeat(start, np.diff(c.starts))
    whole = (
        c.starts[0] == 0
        and c.starts[-1] == c.places.size
        and c.values.shape == c.places.shape == (c.starts[-1],)
        and c.values.dtype == np.float64
    )
    return bool(whole and c.places.dtype == np.int64 and np.all((c.places >= 0) & (c.places < earlier)))
