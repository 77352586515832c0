"""Whether what a checkpoint holds can be a state of this system's steps: nothing else is computed with."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhtbench.errors import ProblemError
from solvers.hht.blocks import Order
from solvers.hht.laws import HIGHEST
from solvers.hht.layout import Layout
from solvers.hht.linear import DenseFactor, Factor, InverseFactor
from solvers.hht.sparse import BandFactor, SpluFactor
from solvers.hht.stepping import Standing


def check(standing: Standing, layout: Layout, events: int) -> None:
    """Raise ProblemError unless ``standing`` is a legal state of steps with ``layout`` and as many events."""
    s = standing
    wrong = [*_misshapen(s, layout, events), *_misfits(s, layout.structure.mass, events)]
    if s.state.factor is not None:
        wrong += _unfit_factor(s.state.factor, 2 * layout.structure.n, layout.size)
    if wrong:
        raise ProblemError(f"the checkpoint does not fit this system: {wrong[0]}.")


def _misshapen(s: Standing, layout: Layout, events: int) -> list[str]:
    """Arrays of a wrong shape, in words."""
    n, m, p, size = layout.structure.n, layout.structure.m, layout.structure.p, layout.size
    state, rows = s.state, s.last.t.size
    known = 0 if state.earlier is None else min(len(state.earlier), HIGHEST)
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
        "a step must not be zero": s.step == 0.0 or state.h == 0.0,
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


def _unfit_factor(factor: Factor, rows: int, size: int) -> list[str]:
    """Shapes and places of a factorisation: compiled loops go by them and look at no bound."""
    fits = factor.h != 0.0 and factor.maps.shape == (rows, size) and len(factor.noise) == 2 and factor.uses >= 0
    if hasattr(factor.maps, "indptr"):
        fits &= factor.maps.indptr.dtype == factor.maps.indices.dtype == np.int32
    if isinstance(factor, DenseFactor):
        fits &= factor.lu.shape == (size, size) and factor.lu.dtype == np.float64
        fits &= _are_places(factor.pivots, (size,), size, np.int32)
    elif isinstance(factor, InverseFactor):
        fits &= factor.inverse.shape == (size, size) and factor.inverse.dtype == np.float64
    elif isinstance(factor, SpluFactor):
        fits &= factor.matrix.shape == (size, size)
    elif isinstance(factor, BandFactor):
        fits &= _is_order(factor.order, size) and _is_band(factor, size)
    return [] if fits else [f"State.factor is no {type(factor).__name__} of {size} unknowns"]


def _are_places(values: Any, shape: tuple[int, ...], size: int, dtype: Any = np.int64) -> bool:
    """Whole numbers of the type ``dtype`` from 0 to before ``size``."""
    return values.shape == shape and values.dtype == dtype and bool(np.all((values >= 0) & (values < size)))


def _is_order(order: Order, size: int) -> bool:
    """Two permutations, and blocks that follow one another."""
    everything, blocks = np.arange(size), order.blocks
    for places in (order.rows, order.columns):
        if not _are_places(places, (size,), size) or not np.array_equal(np.sort(places), everything):
            return False
    if not _are_places(blocks, (blocks.shape[0], 4), size + 1):
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
        and c.values.shape == c.places.shape
        and c.values.dtype == np.float64
    )
    return bool(whole and c.places.dtype == np.int64 and np.all((c.places >= 0) & (c.places < earlier)))
