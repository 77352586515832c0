r"""A band track runs over two wheels: shoes on rubber bushings, penalty contact and friction on both wheels.

Source: shoe and bushings after the band track of an M113 in Project Chrono's vehicle models (a tread and a web together
are one shoe here; the wheels are as large as ``n_wrap`` shoes on half of one ask); contact of Hunt and Crossley, J. Appl.
Mech. 42 (1975) 440-445; planar, with two wheels and friction in place of teeth, by this bench::

          o---o---o---o---o            n = 2 (n_wrap + n_free) shoes (x, y, angle), end to end
        o  .--.           .--. o       o: bushing k, c along both directions, turning_k, turning_c about the pin
       o  ( W1 )         ( W2 ) o      W1: driven by the torque motor (Om - w1) [N m],  W2: braked by brake w2
        o  '--'           '--' o       bearings: W1 at the origin, W2 at (n_free pitch, 0)
          o---o---o---o---o

    0 = g = (-W1, bearing - W2)         4 rows
    every shoe is a circle of radius thickness / 2 about its centre; contact with both wheels, 2 n pairs

At the start all joints lie on the two half circles and the straight lines between them, at rest, bushings without
translation, gaps zero; the turning bushings are free in the straight band.  No closed solution.  lam: bearings [N].  SI
units.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import equinox as eqx
import numpy as np

from hhtbench.mechanics.lines import chain, circle_lines
from hhtbench.mechanics.multibody.mechanism import Mechanism
from hhtbench.mechanics.multibody.system import Multibody
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from problems._common import checked, load_reference

SOURCE = "M113 band track of Project Chrono; Hunt and Crossley, J. Appl. Mech. 42 (1975) 440-445; two wheels by this bench"
SHOE, TURNING = 2.13, 0.002  #: mass [kg] of a shoe and its inertia about its centre [kg m^2]
PITCH, THICKNESS = 0.1101, 0.02  #: of a shoe [m]
WHEEL = 40.0  #: mass of a wheel [kg]
G = 9.81  #: gravity [m/s^2]
MEASURED: Any = eqx.filter_jit(Multibody.measured)
LARGE = 100  # coordinates from which the tag "large" is set: dense linear algebra stops being the best choice about here


def wheel_radius(n_wrap: int) -> float:
    """Radius [m] of wheels that the shoes just touch."""
    return PITCH / (2 * math.tan(math.pi / (2 * n_wrap))) - THICKNESS / 2


def start(n_wrap: int, n_free: int) -> Vector:
    """Shoes (n, 3) [m, m, rad] on two half circles and two lines, counterclockwise from below the right wheel.

    A chord of the length of a shoe turns by ``pi / n_wrap``; the first and last joint of each half circle lie on the lines.
    """
    turn = math.pi / n_wrap
    angles = np.concatenate([np.arange(0.5, n_wrap) * turn, np.full(n_free, math.pi)])
    angles = np.concatenate([angles, math.pi + angles])
    along = PITCH * np.column_stack([np.cos(angles), np.sin(angles)])
    joint = PITCH / (2 * math.sin(turn / 2))  # radius of the joints
    centres = np.cumsum(along, axis=0) - along / 2 + [n_free * PITCH, -joint]
    return np.column_stack([centres, angles])


def mechanism(
    *,
    n_wrap: int = 6,
    n_free: int = 4,
    k: float = 7e7,
    c: float = 3.5e6,
    turning_k: float = 500.0,
    turning_c: float = 25.0,
    contact_k: float = 6e6,
    loss: float = 0.2,
    onset: float = 2e-4,
    mu: float = 0.8,
    creep: float = 0.05,
    motor: float = 20.0,
    Om: float = 10.0,
    brake: float = 5.0,
) -> Mechanism:
    """Bodies ``shoe 0``, ..., ``driven``, ``braked``; ``bushing 0``, ...; contacts ``shoe 0, driven``, ..."""
    made, rows, radius = Mechanism((0.0, -G), plane=True), start(n_wrap, n_free), wheel_radius(n_wrap)
    shoes, wheels = [f"shoe {i}" for i in range(len(rows))], {"driven": (0.0, 0.0), "braked": (n_free * PITCH, 0.0)}
    for shoe, (*at, angle) in zip(shoes, rows, strict=True):
        made.body(shoe, SHOE, TURNING, at=at, turned=angle)
    for wheel, at in wheels.items():
        made.body(wheel, WHEEL, WHEEL * radius**2 / 2, at=at)
        made.revolute(f"bearing, {wheel}", "ground", wheel, at)
    made.torsion("motor's drag", "bearing, driven", 0.0, motor)
    made.load("motor", "driven", torque=motor * Om)
    made.torsion("brake", "bearing, braked", 0.0, brake)
    for i, (*at, angle) in enumerate(rows):
        after = (i + 1) % len(rows)
        end = np.array(at) + PITCH / 2 * np.array([math.cos(angle), math.sin(angle)])
        bend = math.remainder(rows[after, 2] - angle, 2 * math.pi)
        stiffness, damping, straight = (k, k, turning_k), (c, c, turning_c), (0.0, 0.0, -bend)
        made.bushing(f"bushing {i}", shoes[i], shoes[after], end, stiffness, damping, free=straight)
    law: dict[str, Any] = {"stiffness": contact_k, "loss": loss, "onset": onset, "friction": (mu, creep)}
    for wheel, centre in wheels.items():
        for shoe, (*at, _) in zip(shoes, rows, strict=True):
            made.contact(f"{shoe}, {wheel}", shoe, wheel, at, radius=THICKNESS / 2, centre=centre, other=radius, **law)
    return made


def wheel_speeds(t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Rates of the driven and the braked wheel (2,) [rad/s]."""
    return np.array([v[-4], v[-1]])


def largest_push(system: Multibody, t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Largest normal force between a shoe and a wheel [N]."""
    return -float(np.min(MEASURED(system, "ball", q, v)[2]))


def sketch(radius: float, q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: both bearings as ``points`` (2, 2); shoes, wheels and spokes as ``lines`` (n + 50, 2, 2) [m]."""
    bodies = np.asarray(q).reshape(-1, 3)
    arm = np.column_stack([np.cos(bodies[:, 2]), np.sin(bodies[:, 2])])
    x, half = bodies[:, :2], PITCH / 2 * arm[:-2]
    shoes = np.stack([x[:-2] - half, x[:-2] + half], axis=1)
    spokes = [chain([x[i], x[i] + radius * arm[i]]) for i in (-2, -1)]
    return {"points": x[-2:], "lines": np.concatenate([shoes, *(circle_lines(x[i], radius, 24) for i in (-2, -1)), *spokes])}


def problem(
    *,
    n_wrap: int = 6,
    n_free: int = 4,
    k: float = 7e7,
    c: float = 3.5e6,
    turning_k: float = 500.0,
    turning_c: float = 25.0,
    contact_k: float = 6e6,
    loss: float = 0.2,
    onset: float = 2e-4,
    mu: float = 0.8,
    creep: float = 0.05,
    motor: float = 20.0,
    Om: float = 10.0,
    brake: float = 5.0,
    t_end: float = 1.0,
) -> Problem:
    """Make the problem: the track from rest over [0, ``t_end``] [s].

    Parameters
    ----------
    n_wrap, n_free
        Shoes around half a wheel, at least 3, and between the wheels, at least 1; ``2 (n_wrap + n_free)`` in all.
    k, c
        Stiffness [N/m], above 0, and damping [N s/m], at least 0, of a bushing.
    turning_k, turning_c
        The same about its pin [N m/rad, N m s], at least 0.
    contact_k, loss, onset
        Stiffness [N/m^1.5], above 0, and loss [s/m], at least 0, of contact, and gap over which it sets in [m], above 0.
    mu, creep
        Coefficient of friction [1], at least 0, and speed at which 0.71 of it acts [m/s], above 0.
    motor, Om
        Torque of the motor per rate [N m s], at least 0, and rate that it drives to [rad/s], above 0.
    brake
        Torque of the brake per rate [N m s], at least 0.
    """
    wrap, free = positive_integer("n_wrap", n_wrap), positive_integer("n_free", n_free)
    if wrap < 3:
        raise ProblemError(f"n_wrap must be at least 3, for a band around a wheel; got {wrap}.")
    values: dict[str, Any] = {
        "k": checked("k", k, above=0.0, unit="N/m"),
        "c": checked("c", c, at_least=0.0, unit="N s/m"),
        "turning_k": checked("turning_k", turning_k, at_least=0.0, unit="N m/rad"),
        "turning_c": checked("turning_c", turning_c, at_least=0.0, unit="N m s"),
        "contact_k": checked("contact_k", contact_k, above=0.0, unit="N/m^1.5"),
        "loss": checked("loss", loss, at_least=0.0, unit="s/m"),
        "onset": checked("onset", onset, above=0.0, unit="m"),
        "mu": checked("mu", mu, at_least=0.0, unit="1"),
        "creep": checked("creep", creep, above=0.0, unit="m/s"),
        "motor": checked("motor", motor, at_least=0.0, unit="N m s"),
        "Om": checked("Om", Om, above=0.0, unit="rad/s"),
        "brake": checked("brake", brake, at_least=0.0, unit="N m s"),
    }
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    numbers = 7e7, 3.5e6, 500.0, 25.0, 6e6, 0.2, 2e-4, 0.8, 0.05, 20.0, 10.0, 5.0
    published = (wrap, free) == (6, 4) and tuple(values.values()) == numbers
    count, radius = 2 * (wrap + free), wheel_radius(wrap)
    speed, force = radius * values["Om"], SHOE * G * count
    given = mechanism(n_wrap=wrap, n_free=free, **values)
    return given.problem(
        (0.0, t_end),
        name="band_track",
        scales=Scales(
            q=np.tile([radius, radius, 1.0], count + 2), v=np.tile([speed, speed, values["Om"]], count + 2), lam=force
        ),
        observables={"wheel_speeds": wheel_speeds, "largest_push": functools.partial(largest_push, given.system())},
        reference=load_reference("band_track", t_end) if published else None,
        sketch=functools.partial(sketch, radius),
        tags=("holonomic", "stiff", "damped", "contact", *(("large",) if 3 * count + 6 >= LARGE else ())),
        good_for="what engineers take HHT for: stiff damped bushings, many contacts with friction and slow motion at once",
        source=SOURCE,
    )
