r"""A vibrating ball mill: a drum on four rubber mounts in space is shaken, and balls in it hit wall, ends and one another.

Source: rigid bodies by unit quaternions as in P. E. Nikravesh, Computer-Aided Analysis of Mechanical Systems, Prentice Hall
1988; contact of Hunt and Crossley, J. Appl. Mech. 42 (1975) 440-445; the mill is of this bench::

          z ^   .--------.               q = (x, p) of the drum, then of each ball (7 each): place [m], unit quaternion
            |  /          \              force of the exciter at the drum's centre:
            | |      +     |  radius         push (cos Om t, 0, sin Om t)
            |  \ o o o    /              axis of the drum along y, its ends at +- half
         ___|___'--------'___            n balls of radius ball, 3 n + n (n - 1) / 2 contacts
         [ ]                [ ]          four mounts with six stiffnesses each, at (+-0.2 m, +-half, -radius)
      ----------------------------> x

    0 = g = p.p - 1  for every body

Mounts: ``mount_k (1, 1, 2)`` against translation and ``mount_k (0.03 m)^2`` against every turn, with dampers in the same
proportions.  Contact is ``k s^1.5 max(0, 1 + 1.5 c s')`` of the smooth depth s, and friction
``mu N w / sqrt(w^2 + creep^2)``, as in ``hhtbench.mechanics.contact``.  At the start the drum is at rest on free
mounts, and the balls slide along the axis just above the wall, one forth, the next back.  Impacts multiply errors: a long
motion is not predictable.  SI units.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import outline
from hhtbench.mechanics.multibody.mechanism import Mechanism
from hhtbench.mechanics.multibody.system import Multibody
from hhtbench.mechanics.space import rotation, split
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from problems._common import checked, load_reference

SOURCE = "Nikravesh, Prentice Hall 1988; Hunt and Crossley, J. Appl. Mech. 42 (1975) 440-445; the mill is of this bench"
DRUM, BALL = 20.0, 0.5  #: masses of the drum and of a ball [kg]
RADIUS, HALF, SMALL = 0.15, 0.15, 0.025  #: inner radius and half length of the drum, radius of a ball [m]
FEET = np.array([(0.2, HALF, -RADIUS), (0.2, -HALF, -RADIUS), (-0.2, -HALF, -RADIUS), (-0.2, HALF, -RADIUS)])  #: mounts [m]
SHARES = np.array([1.0, 1.0, 2.0, 0.03**2, 0.03**2, 0.03**2])  #: of a mount's stiffness against translations and turns
Y = np.array([0.0, 1.0, 0.0])  #: axis of the drum
SLIDE = 0.7  #: speed of the balls along the axis at the start [m/s]
MOST_BALLS = 5  #: that find room in a row along the bottom


def exciter(push: float, Om: float, t: Array) -> Array:
    """Force (3,) [N] of the exciter."""
    return push * jnp.stack([jnp.cos(Om * t), 0.0, jnp.sin(Om * t)])


def mechanism(
    *,
    n_balls: int = 3,
    mount_k: float = 1e5,
    mount_c: float = 200.0,
    k: float = 1e7,
    c: float = 0.3,
    onset: float = 5e-5,
    mu: float = 0.3,
    creep: float = 0.02,
    push: float = 1500.0,
    Om: float = 100.0,
) -> Mechanism:
    """Make the mill at its start, parameters as in :func:`problem`: bodies ``drum``, ``ball 1``, ..., bushings ``mount 1``,
    ..., load ``exciter``, contacts ``wall 1``, ``front 1``, ``back 1``, ..., ``balls 1, 2``, ...
    """
    mill, law = Mechanism(), dict[str, Any]({"stiffness": k, "loss": c, "onset": onset, "friction": (mu, creep)})
    mill.body("drum", DRUM, (0.3, 0.4, 0.3))
    for i, foot in enumerate(FEET):
        mill.bushing(f"mount {i + 1}", "ground", "drum", foot, mount_k * SHARES, mount_c * SHARES)
    mill.load("exciter", "drum", force=functools.partial(exciter, float(push), float(Om)))
    for i, x in enumerate(row_of_balls(n_balls)):
        ball = mill.body(f"ball {i + 1}", BALL, 3 * [0.4 * BALL * SMALL**2], x, velocity=SLIDE * (-1.0) ** i * Y)
        mill.contact(f"wall {i + 1}", ball, "drum", x, radius=SMALL, centre=0 * Y, other=-RADIUS, axis=Y, **law)
        for name, side in (("front", Y), ("back", -Y)):
            mill.contact(f"{name} {i + 1}", ball, "drum", x, radius=SMALL, point=HALF * side, normal=-side, **law)
        for j in range(i):
            before = mill.bodies[f"ball {j + 1}"].x
            mill.contact(
                f"balls {j + 1}, {i + 1}", f"ball {j + 1}", ball, before, radius=SMALL, centre=x, other=SMALL, **law
            )
    return mill


def row_of_balls(n: int) -> Vector:
    """Centres (n, 3) [m] of balls in a row along the bottom, a fiftieth of their radius above it."""
    along = 2.2 * SMALL * (np.arange(n) - (n - 1) / 2)
    tilt = 0.2 * np.sin(np.arange(n) + 1.0)  # they start beside the lowest line, and so roll
    return np.column_stack([np.sin(tilt), 0 * tilt, -np.cos(tilt)]) * (RADIUS - 1.02 * SMALL) + np.outer(along, Y)


MEASURED: Any = eqx.filter_jit(Multibody.measured)


def centre(t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Centre of the drum (3,) [m]."""
    return np.asarray(q[:3])


def largest_push(system: Multibody, t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Largest normal force of a contact [N]."""
    return -min(float(np.min(MEASURED(system, kind, q, v)[2])) for kind in ("ball", "contact"))


def ring(middle: Vector, R: Vector, radius: float, pieces: int) -> Vector:
    """Circle (pieces, 2, 3) about the axis y of the frame ``R``."""
    turn = np.linspace(0.0, 2 * math.pi, pieces, endpoint=False)
    return np.asarray(outline(middle + radius * np.column_stack([np.cos(turn), 0 * turn, np.sin(turn)]) @ R.T))


def sketch(q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: balls as ``points`` (n, 3); ends, balls, brackets and mounts as ``lines`` (12 n + 56, 2, 3) [m]."""
    x, p = (np.asarray(part) for part in split(q))
    R = np.asarray(rotation(p))
    ends = [ring(x[0] + side * HALF * R[0] @ Y, R[0], RADIUS, 24) for side in (-1.0, 1.0)]
    balls = [ring(x[i], R[i], SMALL, 12) for i in range(1, len(x))]
    sides = np.column_stack([np.sign(FEET[:, 0]) * RADIUS, FEET[:, 1], 0 * FEET[:, 0]])
    held = x[0] + FEET @ R[0].T
    brackets = np.stack([x[0] + sides @ R[0].T, held], axis=1)
    mounts = np.stack([held, FEET - (0.0, 0.0, RADIUS / 3)], axis=1)
    return {"points": x[1:], "lines": np.concatenate([*ends, *balls, brackets, mounts])}


def problem(
    *,
    n_balls: int = 3,
    mount_k: float = 1e5,
    mount_c: float = 200.0,
    k: float = 1e7,
    c: float = 0.3,
    onset: float = 5e-5,
    mu: float = 0.3,
    creep: float = 0.02,
    push: float = 1500.0,
    Om: float = 100.0,
    t_end: float = 0.2,
) -> Problem:
    """Make the problem: the mill from rest over [0, ``t_end``] [s].

    Parameters
    ----------
    n_balls
        n, from 1 to 5.
    mount_k, mount_c
        Stiffness [N/m], above 0, and damping [N s/m], at least 0, of a mount across.
    k, c, onset
        Stiffness [N/m^1.5], above 0, and loss [s/m], at least 0, of contact, and gap over which it sets in [m], above 0.
    mu, creep
        Coefficient of friction [1], at least 0, and speed at which 0.71 of it acts [m/s], above 0.
    push, Om
        Force [N] and rate [rad/s], above 0, of the exciter.
    """
    n = positive_integer("n_balls", n_balls)
    if n > MOST_BALLS:
        raise ProblemError(f"n_balls must be at least 1 and at most {MOST_BALLS}, which find room in a row; got {n}.")
    values = {
        "mount_k": checked("mount_k", mount_k, above=0.0, unit="N/m"),
        "mount_c": checked("mount_c", mount_c, at_least=0.0, unit="N s/m"),
        "k": checked("k", k, above=0.0, unit="N/m^1.5"),
        "c": checked("c", c, at_least=0.0, unit="s/m"),
        "onset": checked("onset", onset, above=0.0, unit="m"),
        "mu": checked("mu", mu, at_least=0.0, unit="1"),
        "creep": checked("creep", creep, above=0.0, unit="m/s"),
        "push": checked("push", push, unit="N"),
        "Om": checked("Om", Om, above=0.0, unit="rad/s"),
    }
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    published = n == 3 and tuple(values.values()) == (1e5, 200.0, 1e7, 0.3, 5e-5, 0.3, 0.02, 1500.0, 100.0)
    made = mechanism(n_balls=n, **values)
    force = max(abs(values["push"]), DRUM * 9.81)
    rate = 1.0 / SMALL  # of balls that roll at 1 m/s
    return made.problem(
        (0.0, t_end),
        name="ball_mill",
        scales=Scales(
            q=np.tile([RADIUS] * 3 + [1.0] * 4, n + 1),
            v=np.tile([1.0] * 3 + [rate / 2] * 4, n + 1),
            lam=np.append(force * RADIUS, np.full(n, BALL)),
        ),
        observables={"centre": centre, "largest_push": functools.partial(largest_push, made.system())},
        reference=load_reference("ball_mill", t_end) if published else None,
        sketch=sketch,
        tags=("holonomic", "variable mass", "stiff", "damped", "contact"),
        good_for="contact and friction in space: balls in a drum on rubber mounts, impacts short against the motion",
        source=SOURCE,
    )
