"""All axes, in the order in which they are told."""

from __future__ import annotations

from collections.abc import Sequence

from hhtbench.errors import NotFoundError
from hhtbench.testing.extremes.cell import Axis
from hhtbench.testing.extremes.forces import contact, friction, jump, wrong_a0
from hhtbench.testing.extremes.long import long_run
from hhtbench.testing.extremes.modes import multiplier_modes
from hhtbench.testing.extremes.quaternions import quaternions
from hhtbench.testing.extremes.ranks import dead_points, rank, redundant
from hhtbench.testing.extremes.recurrence import amplification
from hhtbench.testing.extremes.rods import masses, origin, perturbations, ratios, span, tension, units
from hhtbench.testing.extremes.springs import dampers, order, servo, spin, steps, stiffness

AXES = (
    amplification,
    perturbations,
    multiplier_modes,
    wrong_a0,
    stiffness,
    order,
    dampers,
    servo,
    spin,
    quaternions,
    masses,
    tension,
    steps,
    ratios,
    rank,
    redundant,
    dead_points,
    jump,
    friction,
    contact,
    origin,
    span,
    units,
    long_run,
)


def chosen_axes(names: Sequence[str]) -> tuple[Axis, ...]:
    """Those of these names; none given: all.

    Raises
    ------
    NotFoundError
        A name is none of an axis.
    """
    known = {axis.name: axis for axis in AXES}
    for name in names:
        if name not in known:
            raise NotFoundError(f"there is no axis {name}; known: {', '.join(known)}.")
    return tuple(known[name] for name in names) if names else AXES
