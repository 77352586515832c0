r"""A chain of bars on rubber bushings falls from the horizontal: stiff springs with dampers in the place of pins.

Source: planar, with the shoes and bushings of the band track of an M113 in Project Chrono's vehicle models (tread: mass,
length, inertia about the pin; bushings against translation and about the pin); the chain itself and its damping
3.5e3 N s/m beside Chrono's 3.5e6 are of this bench::

    |//
    |//o======o======o======o== ... ==o        bar i = 1..N: (x_i, y_i, angle_i) [m, m, rad]
    |//   1      2      3          N            o: bushing k, c along both directions, turning_k, turning_c

    bushing i: d_i = R_(i-1)^T (start of bar i - end of bar i-1),  b_i = angle_i - angle_(i-1)   (bar 0 is the ground)
    tension k d + c d',  moment turning_k b + turning_c b';  generalised forces by virtual work

The start is at rest, stretched out along x, free of stress.  The fastest mode of the dampers decays at about
``c L^2 / J`` [1/s], 2e7 for c = 3.5e6, while the motion takes a second.  No closed solution.  SI units.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np

from hhtbench.mechanics.lines import pin_lines
from hhtbench.mechanics.multibody.mechanism import Mechanism
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from problems._common import checked, load_reference

SOURCE = "shoes and bushings of the M113 band track of Project Chrono; the chain is of this bench"
LARGE = 100  # coordinates from which the tag "large" is set: dense linear algebra stops being the best choice about here
NAMES = {3.5e3: "bushing_chain_c3e3", 3.5e6: "bushing_chain_c3e6"}  #: stored references by their damping


def mechanism(
    *,
    n_bars: int = 20,
    m: float = 1.8,
    J: float = 0.001,
    length: float = 0.0753,
    k: float = 7e7,
    c: float = 3.5e3,
    turning_k: float = 500.0,
    turning_c: float = 25.0,
    g: float = 9.81,
) -> Mechanism:
    """Bodies ``bar 1``, ... and bushings ``bushing 1``, ..., of the same parameters as :func:`problem`."""
    chain, before = Mechanism((0.0, -g), plane=True), "ground"
    for i in range(n_bars):
        bar = chain.body(f"bar {i + 1}", m, J, at=(length * (i + 0.5), 0.0))
        chain.bushing(f"bushing {i + 1}", before, bar, (length * i, 0.0), (k, k, turning_k), (c, c, turning_c))
        before = bar
    return chain


def tip(t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Centre of the last bar (2,) [m]."""
    return np.asarray(q[-3:-1])


def stretch(length: float, t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Distance of the points that the first bushing holds together [m]."""
    return math.hypot(q[0] - length / 2 * math.cos(q[2]), q[1] - length / 2 * math.sin(q[2]))


def sketch(length: float, q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: first end and centres as ``points`` (N + 1, 2), bars and support as ``lines`` (N + 9, 2, 2) [m]."""
    x, angle = np.split(np.asarray(q).reshape(-1, 3), [2], axis=1)
    along = length / 2 * np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
    bars = np.stack([x - along, x + along], axis=1)
    return {"points": np.concatenate([bars[:1, 0], x]), "lines": np.concatenate([bars, pin_lines((0.0, 0.0), length)])}


def problem(
    *,
    n_bars: int = 20,
    m: float = 1.8,
    J: float = 0.001,
    length: float = 0.0753,
    k: float = 7e7,
    c: float = 3.5e3,
    turning_k: float = 500.0,
    turning_c: float = 25.0,
    g: float = 9.81,
    t_end: float = 1.0,
) -> Problem:
    """Make the problem: the chain let go over [0, ``t_end``] [s].

    Parameters
    ----------
    n_bars
        N, at least 1.
    m, J, length
        Mass [kg], moment of inertia [kg m^2] and length [m] of a bar, above 0.
    k, c
        Stiffness [N/m], above 0, and damping [N s/m], at least 0, of a bushing; references are for c = 3.5e3 and 3.5e6.
    turning_k, turning_c
        The same against turning [N m/rad, N m s].
    g
        Gravity [m/s^2].
    """
    n = positive_integer("n_bars", n_bars)
    values: dict[str, Any] = {
        "m": checked("m", m, above=0.0, unit="kg"),
        "J": checked("J", J, above=0.0, unit="kg m^2"),
        "length": checked("length", length, above=0.0, unit="m"),
        "k": checked("k", k, above=0.0, unit="N/m"),
        "c": checked("c", c, at_least=0.0, unit="N s/m"),
        "turning_k": checked("turning_k", turning_k, above=0.0, unit="N m/rad"),
        "turning_c": checked("turning_c", turning_c, at_least=0.0, unit="N m s"),
        "g": checked("g", g, unit="m/s^2"),
    }
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    plain = {"m": 1.8, "J": 0.001, "length": 0.0753, "k": 7e7, "turning_k": 500.0, "turning_c": 25.0, "g": 9.81}
    published = n == 20 and values["c"] in NAMES and values == plain | {"c": values["c"]}
    size, speed = n * values["length"], np.sqrt(max(abs(values["g"]), 1e-3) * n * values["length"])
    return mechanism(n_bars=n, **values).problem(
        (0.0, t_end),
        name="bushing_chain",
        scales=Scales(q=np.tile([size, size, 1.0], n), v=np.tile([speed, speed, speed / size], n)),
        observables={"tip": tip, "stretch": functools.partial(stretch, values["length"])},
        reference=load_reference(NAMES[values["c"]], t_end) if published else None,
        sketch=functools.partial(sketch, values["length"]),
        tags=("unconstrained", "stiff", "damped", *(("large",) if 3 * n >= LARGE else ())),
        good_for="bushings instead of joints: decays up to ten million times faster than the motion, any number of bodies",
        source=SOURCE,
    )
