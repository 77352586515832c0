r"""An eccentric cam turns in the yoke of a follower with backlash: contact changes sides twice a turn, with friction.

Source: textbook mechanics (an eccentric in a yoke without backlash is a Scotch yoke, lift = ecc sin(Om t)); contact of
Hunt and Crossley, J. Appl. Mech. 42 (1975) 440-445; the numbers are of this bench::

              | |                       q = (x_c, y_c, angle_c, x_f, y_f, angle_f): cam, follower [m, m, rad]
       =======| |=======  upper flat    O: bearing of the cam, ecc away from its middle C
           (       )                    the flats are 2 radius + backlash apart
          (   C     )                   the follower slides along y
           ( O     )      lower flat    spring spring_k to its place at the start
       =======| |=======

    0 = g = (ecc (cos, sin) angle_c - C,  x_f,  angle_f,  angle_c - Om t)
    gaps: backlash / 2 + (y_f - y_c)  above,  backlash / 2 - (y_f - y_c)  below

Push of a flat ``N = k s^1.5 max(0, 1 + 1.5 c s')`` with the smooth depth s of ``hhtbench.mechanics.contact``, friction
``mu N w / sqrt(w^2 + creep^2)`` against the sliding velocity w.  The follower starts at rest relative to the cam, in
the middle of the backlash.  lam: bearing [N, N], guide [N, N m], drive [N m].  SI units.
"""

from __future__ import annotations

import functools
from typing import Any

import equinox as eqx
import numpy as np

from hhtbench.mechanics.lines import chain, circle_lines, pin_lines
from hhtbench.mechanics.multibody.mechanism import Mechanism
from hhtbench.mechanics.multibody.system import Multibody
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from problems._common import checked, load_reference

SOURCE = (
    "textbook mechanics, eccentric in a yoke; Hunt and Crossley, J. Appl. Mech. 42 (1975) 440-445; numbers of this bench"
)
MASSES = 3.0, 2.0  #: of cam and follower [kg]
RADIUS = 0.05  #: of the cam [m]
G = 9.81  #: gravity [m/s^2]
MEASURED: Any = eqx.filter_jit(Multibody.measured)


def turned(Om: Any, t: Any) -> Any:
    """Angle of the cam [rad] at ``t`` [s]."""
    return Om * t


def mechanism(
    *,
    ecc: float = 0.02,
    backlash: float = 5e-4,
    Om: float = 40.0,
    spring_k: float = 500.0,
    k: float = 1e8,
    c: float = 0.5,
    mu: float = 0.1,
    onset: float = 1e-5,
    creep: float = 0.02,
) -> Mechanism:
    """Bodies ``cam``, ``follower``, joints ``bearing``, ``guide``, ``drive``, ``spring``, contacts ``upper``, ``lower``."""
    made = Mechanism((0.0, -G), plane=True)
    cam, follower = MASSES
    made.body("cam", cam, cam * RADIUS**2 / 2, at=(ecc, 0.0), velocity=(0.0, ecc * Om), rate=Om)
    made.body("follower", follower, follower * RADIUS**2 / 2, velocity=(0.0, ecc * Om))
    made.revolute("bearing", "ground", "cam", (0.0, 0.0))
    made.prismatic("guide", "ground", "follower", (0.0, 0.0), (0.0, 1.0))
    made.motor("drive", "bearing", functools.partial(turned, Om))
    made.bushing("spring", "ground", "follower", (0.0, 0.0), (0.0, spring_k, 0.0))
    law: dict[str, Any] = {"stiffness": k, "loss": c, "onset": onset, "friction": (mu, creep)}
    for flat, side in (("upper", 1.0), ("lower", -1.0)):
        point, inward = (0.0, side * (RADIUS + backlash / 2)), (0.0, -side)
        made.contact(flat, "cam", "follower", (ecc, 0.0), radius=RADIUS, point=point, normal=inward, **law)
    return made


def lift(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Lift of the follower [m]."""
    return float(q[4])


def push(system: Multibody, t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Normal forces of the upper and the lower flat (2,) [N]."""
    return -np.asarray(MEASURED(system, "contact", q, v)[2])


def sketch(radius: float, ecc: float, half: float, q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: bearing and middles as ``points`` (3, 2); cam, spoke, yoke, support as ``lines`` (38, 2, 2) [m]."""
    q = np.asarray(q)
    cam, follower = q[:2], q[3:5]
    width = 1.5 * radius
    flats = follower + np.array([[(x, y) for x in (-width, width)] for y in (-half, half)])
    stem = chain(follower + np.array([(0.0, half), (0.0, half + radius)]))
    rim = circle_lines(cam, radius, 24)
    spoke = chain([cam, cam + radius * np.array([np.cos(q[2]), np.sin(q[2])])])
    points = np.array([[0.0, 0.0], cam, follower])
    return {"points": points, "lines": np.concatenate([rim, spoke, flats, stem, pin_lines((0.0, 0.0), ecc / 2)])}


def problem(
    *,
    ecc: float = 0.02,
    backlash: float = 5e-4,
    Om: float = 40.0,
    spring_k: float = 500.0,
    k: float = 1e8,
    c: float = 0.5,
    mu: float = 0.1,
    onset: float = 1e-5,
    creep: float = 0.02,
    t_end: float = 0.5,
) -> Problem:
    """Make the problem: the cam at a constant rate over [0, ``t_end``] [s].

    Parameters
    ----------
    ecc
        From the bearing to the middle of the cam [m], above 0 and below its radius, 0.05.
    backlash
        Distance of the flats less the cam's diameter [m], at least 0.
    Om
        Rate of the cam [rad/s], above 0.
    spring_k
        Stiffness of the follower's spring [N/m], at least 0.
    k, c
        Stiffness [N/m^1.5], above 0, and loss [s/m], at least 0, of contact.
    mu
        Coefficient of friction [1], at least 0.
    onset, creep
        Gap over which contact sets in [m] and speed at which 0.71 of the friction acts [m/s], above 0.
    """
    values: dict[str, Any] = {
        "ecc": checked("ecc", ecc, above=0.0, below=0.05, unit="m"),
        "backlash": checked("backlash", backlash, at_least=0.0, unit="m"),
        "Om": checked("Om", Om, above=0.0, unit="rad/s"),
        "spring_k": checked("spring_k", spring_k, at_least=0.0, unit="N/m"),
        "k": checked("k", k, above=0.0, unit="N/m^1.5"),
        "c": checked("c", c, at_least=0.0, unit="s/m"),
        "mu": checked("mu", mu, at_least=0.0, unit="1"),
        "onset": checked("onset", onset, above=0.0, unit="m"),
        "creep": checked("creep", creep, above=0.0, unit="m/s"),
    }
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    published = tuple(values.values()) == (0.02, 5e-4, 40.0, 500.0, 1e8, 0.5, 0.1, 1e-5, 0.02)
    ecc, speed = values["ecc"], values["ecc"] * values["Om"]
    force = MASSES[1] * (speed * values["Om"] + G)
    given = mechanism(**values)
    return given.problem(
        (0.0, t_end),
        name="cam_follower",
        scales=Scales(
            q=np.array([ecc, ecc, 1.0] * 2),
            v=np.array([speed, speed, values["Om"]] * 2),
            lam=np.array([force, force, force, force * ecc, force * ecc]),
        ),
        observables={"lift": lift, "push": functools.partial(push, given.system())},
        reference=load_reference("cam_follower", t_end) if published else None,
        sketch=functools.partial(sketch, RADIUS, ecc, RADIUS + values["backlash"] / 2),
        tags=("holonomic", "rheonomic", "stiff", "damped", "contact"),
        good_for="impacts across backlash in a mechanism with constraints, seen in the drive's multiplier and in the energy",
        source=SOURCE,
    )
