"""Where the published values of the spatial problems are found in our states; quaternions: scalar first in both."""

import numpy as np

from hhtbench.mechanics.space import body_rate
from problems.bricard import middle
from problems.flyball_governor import arm_angle, shaft_angle, shaft_rate, slider_height
from tests.problems.published import Published

MEAN_TURNING_RATE = 5.59  # of the governor [rad/s], in the published angles within 0.2 rad over all of its 10 s


def of_state(observable):
    """An observable as a function of the state."""
    return lambda s: observable(s.t, s.q, s.v, s.lam)


def total_shaft_angle(s):
    """Whole turns included: those that bring the angle, known modulo 2 pi, next to the mean motion."""
    angle = shaft_angle(s.t, s.q, s.v, s.lam)
    return angle + 2 * np.pi * np.round((MEAN_TURNING_RATE * s.t - angle) / (2 * np.pi))


PUBLISHED = {
    "heavy_top": Published(
        spec="heavy_top",
        values={
            "x": lambda s: s.q[:3],
            "p": lambda s: s.q[3:],
            "xdot": lambda s: s.v[:3],
            "lam_pos": lambda s: s.lam[1:],  # lam[0], of the norm, is not published
            "omega_body": lambda s: np.asarray(body_rate(s.q[3:], s.v[3:])),
        },
    ),
    "rolling_sphere_table": Published(
        spec="rolling_sphere_table",
        values={
            "q": lambda s: s.q,
            "v": lambda s: s.v,
            # [lam; mu]; the published multiplier of the norm is (4 J + 2 j0) p'.p' with j0 = J, from the general quaternion
            # mass 4 G^T J G + 4 j0 p p^T and its quadratic force; ours is 2 J p'.p', a third, from the constant mass 4 J
            "lam": lambda s: np.concatenate([3 * s.lam, s.mu]),
        },
    ),
    "rolling_disk3d_steady": Published(
        spec="rolling_disk3d_steady",
        values={"q": lambda s: s.q, "v": lambda s: s.v, "lam": lambda s: np.concatenate([s.lam, s.mu])},
    ),
    "iftomm_A04_bricard": Published(spec="bricard", values={"P3": lambda s: middle(1.0, s.t, s.q, s.v, s.lam)}),
    "iftomm_A05_flyball": Published(
        spec="flyball_governor",
        values={
            "s": of_state(slider_height),
            "alpha": of_state(arm_angle),
            "phi": total_shaft_angle,
            "omega": of_state(shaft_rate),
        },
    ),
}
