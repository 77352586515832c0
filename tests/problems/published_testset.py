"""Where the published numbers of the Test Set's problems, the SUNDIALS example and the linear ones stand in our states."""

import numpy as np

from tests.problems.published import Published

STATE = {"q": lambda s: s.q, "v": lambda s: s.v, "lam": lambda s: s.lam}
BAR = {"q_tip": lambda s: s.q[-1], "v_tip": lambda s: s.v[-1], "lam": lambda s: s.lam[0]}  # one number a time


def logarithmic_energy(s):
    """-sum of log |p_i - p_j| over the pairs; the kinetic energy is gone by the time it is compared."""
    p = s.q.reshape(-1, 3)
    i, j = np.triu_indices(len(p), 1)
    return -np.log(np.linalg.norm(p[i] - p[j], axis=1)).sum()


PUBLISHED = {
    "car_axis": Published(
        spec="car_axis",
        values=STATE,
        left_out={"published": "the Test Set's own digits of (q, v, lam), fewer than those of the other keys"},
    ),
    "slider_crank_flexible_ini2": Published(spec="slider_crank_flexible", values=STATE),
    "fekete": Published(
        spec="fekete(t_end=1000)",
        values={
            "q_positions": lambda s: s.q,  # point after point in both
            "v_velocities": lambda s: s.v,
            "t1000_q_positions": lambda s: s.q,
            "energy_t1000": logarithmic_energy,
        },
        times={"q_positions": 1.0, "v_velocities": 1.0, "t1000_q_positions": 1000.0, "energy_t1000": 1000.0},
        digits=12,  # DOP853 with projection, in doubles
        left_out={"invariant": "a sentence; the closed multipliers are claimed in test_testset.py"},
    ),
    "sundials_slider_crank": Published(spec="sundials_slider_crank", values=STATE),
    "clamped_bar_impact_N10": Published(spec="clamped_bar_impact(n_elements=10)", values=BAR, digits=10),
    "clamped_bar_impact_N100": Published(spec="clamped_bar_impact(n_elements=100)", values=BAR, digits=10),
    "hf_linear_constrained_K1e4": Published(spec="hf_linear_constrained(stiffness=1e4)", values=STATE),
    "hf_linear_constrained_K1e8": Published(spec="hf_linear_constrained(stiffness=1e8)", values=STATE),
}
