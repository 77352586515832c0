"""Published values of the small problems.

Most entries hold full states in our layout; multipliers of velocity constraints stand under "lam" there and are our ``mu``.
"""

from tests.problems.published import Published


def states(spec, multipliers):
    """An entry with q, v and lam at each of its times."""
    return Published(spec=spec, values={"q": lambda s: s.q, "v": lambda s: s.v, "lam": multipliers})


def position_multipliers(s):
    return s.lam


def velocity_multipliers(s):
    return s.mu


PUBLISHED = {
    "chaplygin_sleigh": states("chaplygin_sleigh", velocity_multipliers),
    "rolling_disk_incline": states("rolling_disk_incline", velocity_multipliers),
    "nonholonomic_particle": states("nonholonomic_particle", velocity_multipliers),
    "arevalo_circle": states("arevalo_circle", position_multipliers),
    "bead_on_rotating_rod": states("bead_on_rotating_rod", position_multipliers),
    "kapitza_pendulum": states("kapitza_pendulum", position_multipliers),
    "pendulum_period2": states("pendulum_period2", position_multipliers),
    "iftomm_A01_pendulum": Published(
        spec="simple_pendulum",
        values={
            "x,y": lambda s: s.q,
            "u,v": lambda s: s.v,
            "lam": position_multipliers,
            "t=9.99": lambda s: s.q,
            "x(1),y(1)": lambda s: s.q,
        },
        times={"t=9.99": 9.99, "x(1),y(1)": 1.0},
    ),
}
