"""Where the published values of the chains and of the mechanisms with singular positions are found in our states."""

import json
import math

import numpy as np

from problems import _common
from tests.problems.published import Published, State, closed
from tests.problems.reductions import crank_state

FULL = {"q": lambda s: s.q, "v": lambda s: s.v, "lam": lambda s: s.lam}


def planar_tip(s):
    """(x, y, u, v) of the free end, half a rod behind the last centre; N rods are 1 m long."""
    (x, y, angle), (u, v, rate) = s.q[-3:], s.v[-3:]
    half = 0.5 / (s.q.size // 3)
    along, across = half * math.cos(angle), half * math.sin(angle)
    return [x + along, y + across, u - across * rate, v + along * rate]


def planar_chain(n):
    return Published(spec=f"planar_chain(n_links={n})", values={"tip_xyuv": planar_tip})


def bead_chain(n):
    values = {"tip": lambda s: s.q[-3:], "tip_vel": lambda s: s.v[-3:], "lam1": lambda s: s.lam[0]}
    return Published(spec=f"bead_chain(n_beads={n})", values=values, digits=11)  # DOP853 at two tolerances, in doubles


def four_bars(n):
    """Crank 0 stands at the origin, B0 at twice its centre; ours counts angles from the x axis, the entry from the upright.

    All times lie behind the first singular position (0.71 s), where no solver knows which branch is meant.
    """
    values = {
        "B0x": lambda s: 2 * s.q[0],
        "B0y": lambda s: 2 * s.q[1],
        "phi": lambda s: math.pi / 2 - s.q[2],
        "phid": lambda s: -s.v[2],
    }
    return Published(
        spec=f"four_bars(n_windows={n})",
        values=values,
        instead=closed(f"four_bars(n_windows={n})"),
        after=0.0,
        bar=1e-14,
        why="behind the singular position the entry holds the smooth branch, as the closed solution does",
    )


def stiff_spring_pendulum(stiffness, values=FULL):
    return Published(spec=f"stiff_spring_pendulum(stiffness={stiffness})", values=values)


def stiffest(t):
    """Stiffness 1e12: the rigid limit and the part that falls like 1 / stiffness, from two stored references."""
    rows = {}
    for stem in ("k1e8", "rigid"):
        stored = json.loads((_common.REFERENCES / f"stiff_spring_pendulum_{stem}.json").read_text(encoding="utf-8"))
        rows[stem] = np.array(stored["values"]["q"][int(np.argmin(np.abs(np.array(stored["t"]) - t)))])
    q = rows["rigid"] + 1e-4 * (rows["k1e8"] - rows["rigid"])
    return State("stiff_spring_pendulum(stiffness=1e12)", t, q, None, None, None)


def crank_of_equal_lengths(t):
    return State("slider_crank_equal_lengths", t, *crank_state(t), None, None)


PUBLISHED = {
    **{f"planar_chain_N{n}": planar_chain(n) for n in (1, 2, 4, 8, 16)},
    **{f"bead_chain3d_N{n}": bead_chain(n) for n in (4, 16)},
    **{f"iftomm_A02_fourbar_N{n}": four_bars(n) for n in (1, 2)},
    **{f"stiff_spring_pendulum_k{k}": stiff_spring_pendulum(k) for k in ("1e2", "1e4", "1e6", "1e8")},
    "stiff_spring_pendulum_k1e12": Published(
        spec="stiff_spring_pendulum(stiffness=1e12)",
        values={"q": lambda s: s.q},  # the entry has no more
        instead=stiffest,
        after=0.0,
        bar=1e-11,
        why="the last bit of a coordinate changes the spring's force by 1e-4 N: the entry is a limit of softer springs too",
    ),
    "stiff_spring_pendulum_rigid_limit": stiff_spring_pendulum("inf"),
    "slider_crank_equal_lengths": Published(
        spec="slider_crank_equal_lengths",
        values={"crank_angle": lambda s: s.q[0], "crank_rate": lambda s: s.v[0]},
        instead=crank_of_equal_lengths,
        after=0.1,
        bar=2e-12,
        why="behind the singular position at 0.25 s the entry holds the smooth branch b = -a, an equation of one degree",
    ),
}
