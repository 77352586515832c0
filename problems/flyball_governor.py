r"""A flyball governor: two arms with balls on a turning shaft, held by stiff springs and dampers from a sliding mass.

Source: IFToMM library of computational benchmark problems for multibody dynamics, A05 (flyball governor)::

                  | z
          hinge o-+-o (d, 0, H)          q: centre [m] and unit quaternion, scalar first, of
              ,'  |  `.                     shaft, slider, arm 1, arm 2: 4 x 7
            ,' \  |  / `.  arm, alpha    arm: rod of length l, ball at its end, hinge across the shaft;
          ,'    K,C     `.   below level    alpha is its angle below the level
        (O)     \ | /     (O) ball       spring K and damper C, side by side, from the slider (d, 0, s)
                [ | ] slider, height s      to the middle of the arm: F = K (L - l0) + C L'
                [_|_]
                  |                      the shaft turns freely about z, the slider turns with it
                __|__ ground

4 degrees of freedom (s, two arm angles, shaft angle), 24 independent position constraints in this order: four norms
``p.p - 1``; the common points of shaft in ground, arm 1 and arm 2 on the shaft (9 rows [m]) and their axes (6 rows); of the
slider in the shaft its axis (2 rows), its place across (2 rows [m]) and its turn (1 row).

The source gives shaft and arms 1 x 0.01 x 0.01 m, a slider of side 0.1 m, density 3000 kg/m^3 and balls of 5 kg as points.
At the start the springs are free, and the eigenvalues of the motion (1/s) are -8117 and -1450 of the dampers against slider
and arms, -20.3 and -20.1 (near -K/C) of springs that relax against their dampers, and +-7.35i of the swing of arms and
slider together, which the shaft answers with its turning rate.  The dampers take energy; the moment of momentum about z is
constant.  SI units.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from hhtbench.mechanics.multibody.mechanism import Mechanism
from hhtbench.mechanics.space import rotation, space_rate, split
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from problems._common import checked, load_reference
from problems._spatial import vertical_momentum

SOURCE = "IFToMM library of computational benchmark problems, A05"
HEIGHT, OFFSET, SIDE, SECTION, DENSITY = 1.0, 0.05, 0.1, 0.01, 3000.0  #: H, d, slider, shaft and arms [m]; [kg/m^3]
ROD = DENSITY * HEIGHT * SECTION**2  #: mass of the shaft and of an arm without its ball [kg]
PUBLISHED = {"K": 8e5, "C": 4e4, "l0": 0.5, "ball": 5.0, "g": 9.81, "s": 0.5, "alpha": math.pi / 6, "omega": 2 * math.pi}
X, Y, Z = np.eye(3)


def centre_of_arm(ball: float) -> float:
    """Distance [m] from the hinge of an arm to its centre of mass with a ``ball`` [kg]."""
    return (ROD / 2 + ball) * HEIGHT / (ROD + ball)


def mechanism(
    *,
    K: float = 8e5,
    C: float = 4e4,
    l0: float = 0.5,
    ball: float = 5.0,
    g: float = 9.81,
    s: float = 0.5,
    alpha: float = math.pi / 6,
    omega: float = 2 * math.pi,
) -> Mechanism:
    """Make the governor at its start, parameters as in :func:`problem`: bodies ``shaft``, ``slider``, ``arm 1``, ``arm 2``;
    joints ``bearing``, ``pin 1``, ``pin 2``, ``sleeve``; springs ``spring 1``, ``spring 2``.
    """
    made, box, centre = Mechanism((0.0, 0.0, -g)), DENSITY * SIDE**3, centre_of_arm(ball)
    thin, slender = ROD * SECTION**2 / 6, ROD * (HEIGHT**2 + SECTION**2) / 12
    across = slender + ROD * (centre - HEIGHT / 2) ** 2 + ball * (HEIGHT - centre) ** 2
    made.invariants["vertical_momentum"] = vertical_momentum
    made.body("shaft", ROD, (slender, slender, thin), HEIGHT / 2 * Z, rate=omega * Z)
    made.body("slider", box, 3 * [box * SIDE**2 / 6], s * Z, rate=omega * Z)
    made.revolute("bearing", "ground", "shaft", 0 * Z, Z)
    cos, sin = math.cos(alpha / 2), math.sin(alpha / 2)
    for i, side, turned in ((1, X, (cos, 0, sin, 0)), (2, -X, (0, -sin, 0, cos))):  # arm 2: half a turn, then the tilt
        hinge, along = HEIGHT * Z + OFFSET * side, math.cos(alpha) * side - math.sin(alpha) * Z
        x = hinge + centre * along
        motion = {"velocity": omega * np.cross(Z, x), "rate": omega * Z}
        made.body(f"arm {i}", ROD + ball, (thin, across, across), x, turned=turned, **motion)
        made.revolute(f"pin {i}", "shaft", f"arm {i}", hinge, Y)
        ends = s * Z + OFFSET * side, hinge + HEIGHT / 2 * along
        made.spring(f"spring {i}", "slider", f"arm {i}", *ends, K, C, free=l0)
    made.prismatic("sleeve", "shaft", "slider", s * Z, Z)
    return made


def typical_sizes(mass: float, rate: float) -> Scales:
    """Scales from the total mass [kg] and the fastest rotation [rad/s]; multipliers in the order of the constraints."""
    force = mass * HEIGHT * rate**2
    moment = force * HEIGHT
    return Scales(
        q=np.tile([HEIGHT] * 3 + [1.0] * 4, 4),
        v=np.tile([HEIGHT * rate] * 3 + [rate / 2] * 4, 4),
        lam=np.array([moment] * 4 + [force] * 9 + [moment] * 8 + [force] * 2 + [moment]),
    )


def slider_height(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Height s of the slider on the shaft [m]."""
    return float(q[9])


def arm_angle(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Angle alpha of arm 1 below the horizontal [rad]."""
    x, y, z = np.asarray(rotation(q[17:21]))[:, 0]
    return math.atan2(-z, math.hypot(x, y))


def shaft_angle(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Angle of the shaft [rad] modulo whole turns, in [-pi, pi]."""
    return math.remainder(2 * math.atan2(q[6], q[3]), 2 * math.pi)


def shaft_rate(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Angular velocity omega of the shaft [rad/s]."""
    return float(space_rate(q[3:7], v[3:7])[2])


def sketch(centre: float, q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: pivot, hinges and balls as ``points`` (5, 3); shaft, hinge bar, arms, slider, springs as ``lines``
    (36, 2, 3) [m].
    """
    x, p = map(np.asarray, split(q))
    R = np.asarray(rotation(p))
    top, foot = x[0] + HEIGHT / 2 * R[0, :, 2], x[0] - HEIGHT / 2 * R[0, :, 2]
    hinges, balls, middles = (x[2:] + (part - centre) * R[2:, :, 0] for part in (0.0, HEIGHT, HEIGHT / 2))
    ring = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]])
    lid, floor = (x[1] + SIDE / 2 * np.column_stack([ring, np.full(5, side)]) @ R[1].T for side in (1, -1))
    box = [np.stack(pair, axis=1) for pair in ((lid[:-1], lid[1:]), (floor[:-1], floor[1:]), (lid[:-1], floor[:-1]))]
    share = np.linspace(0.0, 1.0, 11)[:, None]
    zigzag = 0.03 * np.concatenate([[0], np.tile([1, -1], 4), [1, 0]])[:, None]
    springs = []
    for begin, end in zip(x[1] + OFFSET * np.stack([X, -X]) @ R[1].T, middles, strict=True):
        across = np.cross(end - begin, R[0, :, 1])
        coil = begin + share * (end - begin) + zigzag * across / np.linalg.norm(across)
        springs.append(np.stack([coil[:-1], coil[1:]], axis=1))
    bars = [(foot, top), hinges, (hinges[0], balls[0]), (hinges[1], balls[1])]
    return {"points": np.array([foot, *hinges, *balls]), "lines": np.concatenate([bars, *box, *springs])}


def problem(
    *,
    K: float = 8e5,
    C: float = 4e4,
    l0: float = 0.5,
    ball: float = 5.0,
    g: float = 9.81,
    s: float = 0.5,
    alpha: float = math.pi / 6,
    omega: float = 2 * math.pi,
    t_end: float = 10.0,
) -> Problem:
    """Make the problem: the governor over [0, ``t_end``] [s], turning at the start while slider and arms rest on the shaft.

    Parameters
    ----------
    K, C, l0
        Stiffness [N/m], damping [N s/m] and free length [m] of the springs, at least 0.
    ball
        Mass at the end of an arm [kg], at least 0.
    g
        Gravity [m/s^2].
    s, alpha, omega
        Height of the slider [m] on the shaft, in (0, 1), angle of the arms below the level [rad], in
        (-pi/2, pi/2), and turning rate [rad/s] at the start.
    """
    values = {
        "K": checked("K", K, at_least=0.0, unit="N/m"),
        "C": checked("C", C, at_least=0.0, unit="N s/m"),
        "l0": checked("l0", l0, at_least=0.0, unit="m"),
        "ball": checked("ball", ball, at_least=0.0, unit="kg"),
        "g": checked("g", g, unit="m/s^2"),
        "s": checked("s", s, above=0.0, below=HEIGHT, unit="m"),
        "alpha": checked("alpha", alpha, above=-math.pi / 2, below=math.pi / 2, unit="rad"),
        "omega": checked("omega", omega, unit="rad/s"),
    }
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    made = mechanism(**values)
    mass, pull = sum(body.mass for body in made.bodies.values()), math.sqrt(abs(values["g"]) / HEIGHT)
    return made.problem(
        (0.0, t_end),
        name="flyball_governor",
        scales=typical_sizes(mass, max(abs(values["omega"]), pull, 0.1)),
        observables={
            "slider_height": slider_height,
            "arm_angle": arm_angle,
            "shaft_angle": shaft_angle,
            "shaft_rate": shaft_rate,
        },
        reference=load_reference("flyball_governor", t_end) if values == PUBLISHED else None,
        sketch=functools.partial(sketch, centre_of_arm(values["ball"])),
        tags=("holonomic", "stiff", "damped", "variable mass"),
        good_for="Stiff dampers (8117/s) inside a mechanism that swings slowly: only a method that takes the force "
        "implicitly may choose its step by the motion, and its multipliers must not suffer.",
        source=SOURCE,
    )
