"""Random scenes from the library's problems: sizes, masses, stiffnesses, spans and starts, uniform in wide ranges.

The shipped database consists of these and the library's own scenes; ``hhtbench study selection`` judges advice on them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

SEED = 1818
EACH = 2  #: scenes of every family of soft, and of small stiff, mechanisms
EACH_OF_WING = 3  #: of every family of ``WING``: they are fewer, and a nearest neighbour must be of another family
Range = tuple[float, float]  #: ends of the interval; two whole numbers: a whole number between them, both included

FAMILIES: Mapping[str, Mapping[str, Range]] = {
    "andrews": {"mom": (0.02, 0.05), "c0": (2e3, 9e3), "t_end": (0.01, 0.05)},
    "arevalo_circle": {"c": (1.2, 4.0), "t_end": (3.0, 12.0)},
    "bead_chain": {"n_beads": (2, 10), "L": (0.3, 3.0), "w": (0.2, 1.0), "t_end": (0.3, 2.0)},
    "bead_on_rotating_rod": {"Om": (1.0, 5.0), "u0": (0.0, 2.0), "t_end": (0.5, 2.0)},
    "bricard": {"m": (0.3, 3.0), "L": (0.5, 2.0), "t_end": (0.3, 2.0)},
    "car_axis": {"eps": (0.01, 0.1), "w": (3.0, 20.0), "t_end": (1.0, 5.0)},
    "chaplygin_sleigh": {"a": (0.05, 0.6), "u0": (0.1, 2.0), "w0": (0.5, 4.0), "t_end": (2.0, 10.0)},
    "clamped_bar_impact": {"n_elements": (4, 30), "EA": (0.3, 10.0), "t_end": (1.0, 4.0)},
    "driven_coordinate": {"A": (0.2, 3.0), "w": (0.5, 5.0), "t_end": (2.0, 12.0)},
    "fekete": {"n_points": (4, 14), "damping": (0.1, 1.0), "t_end": (5.0, 50.0)},
    "flyball_governor": {"ball": (2.0, 10.0), "K": (1e5, 3e6), "C": (5e3, 8e4), "t_end": (0.3, 2.0)},
    "four_bars": {"n_windows": (1, 4), "speed": (0.5, 2.0), "t_end": (0.3, 2.0)},
    "fput_chain": {"n_masses": (4, 40), "alpha": (0.05, 0.3), "amplitude": (0.3, 1.5), "t_end": (5.0, 40.0)},
    "heavy_top": {"spin": (30.0, 250.0), "turn": (-6.0, -1.0), "t_end": (0.2, 1.0)},
    "hf_linear_constrained": {"stiffness": (1e3, 1e6), "stretch": (1e-4, 3e-3), "t_end": (1.0, 5.0)},
    "jay_negrut_pendulum": {"k": (300.0, 3e4), "c": (5.0, 300.0), "t_end": (1.0, 6.0)},
    "kapitza_pendulum": {"A": (0.02, 0.1), "w": (40.0, 150.0), "angle0": (0.05, 0.5), "t_end": (0.5, 4.0)},
    "knife_edge": {"incline": (0.2, 1.0), "Om": (0.7, 5.0), "t_end": (2.0, 10.0)},
    "nonholonomic_particle": {"y0": (0.3, 3.0), "vx": (0.3, 3.0), "vy": (0.1, 1.0), "t_end": (3.0, 20.0)},
    "oscillator_chain": {"n_masses": (4, 60), "k": (1e2, 1e6), "t_end": (0.3, 2.0)},
    "planar_chain": {"n_links": (2, 16), "L": (0.5, 2.0), "t_end": (0.3, 1.5)},
    "redundant_pendulum": {"factor": (0.3, 3.0), "amplitude": (0.3, 2.5), "t_end": (2.0, 10.0)},
    "rolling_disk3d_steady": {"theta": (0.8, 1.4), "Om": (2.0, 5.0), "t_end": (2.0, 8.0)},
    "rolling_disk_incline": {"gs": (1.0, 6.0), "Om": (0.5, 3.0), "spin": (1.0, 4.0), "t_end": (2.0, 8.0)},
    "rolling_sphere_table": {"Om": (1.0, 5.0), "vx": (-0.5, 0.5), "wz": (-2.0, 2.0), "t_end": (3.0, 15.0)},
    "simple_pendulum": {"L": (0.3, 3.0), "amplitude": (0.3, 2.9), "t_end": (2.0, 20.0)},
    "slider_crank_equal_lengths": {"angle": (0.3, 1.0), "rate": (2.0, 6.0), "t_end": (0.05, 0.2)},
    "stiff_spring_pendulum": {"stiffness": (1e3, 1e6), "m2": (0.3, 3.0), "t_end": (0.3, 2.0)},
    "sundials_slider_crank": {"F": (0.3, 3.0), "k": (0.3, 3.0), "c": (0.1, 2.0), "t_end": (3.0, 15.0)},
}
WING: Mapping[
    str, Mapping[str, Range]
] = {  # flexible, stiff and contact scenes; small, so that two methods agree in seconds
    "ball_mill": {"n_balls": (1, 2), "k": (1e5, 1e7), "push": (500.0, 2000.0), "t_end": (0.01, 0.04)},
    "band_track": {"n_wrap": (3, 5), "n_free": (2, 4), "c": (3e3, 3.5e6), "Om": (5.0, 20.0), "t_end": (0.02, 0.1)},
    "belt_drive": {"n_elements": (8, 10), "damping": (4.0, 80.0), "k": (1e5, 2.5e6), "t_end": (0.01, 0.04)},
    "bushing_chain": {"n_bars": (3, 20), "k": (1e6, 1e8), "c": (3e3, 3.5e6), "t_end": (0.1, 1.0)},
    "cable_pendulum": {
        "n_elements": (2, 5),
        "EA": (300.0, 3e3),
        "EI": (0.05, 2.0),
        "damping": (0.3, 10.0),
        "t_end": (0.1, 0.3),
    },
    "cam_follower": {"backlash": (1e-4, 1e-3), "Om": (20.0, 60.0), "k": (1e6, 1e8), "t_end": (0.05, 0.2)},
    "falling_net": {"n_side": (3, 4), "EA": (1e4, 1e6), "damping": (10.0, 400.0), "t_end": (0.2, 0.8)},
    "flexible_crank": {"n_elements": (2, 4), "Om": (50.0, 200.0), "beta": (1e-6, 1e-4), "t_end": (0.01, 0.05)},
    "mooring_line": {
        "n_segments": (5, 15),
        "EA": (1e6, 2e8),
        "zeta": (0.3, 1.0),
        "period": (4.0, 10.0),
        "t_end": (1.0, 4.0),
    },
    "right_angle_cantilever": {"n_elements": (1, 2), "EI": (500.0, 5e3), "peak": (10.0, 60.0), "t_end": (1.0, 3.0)},
    "spinup_beam": {"n_elements": (2, 8), "rate": (2.0, 6.0), "spin_up": (5.0, 15.0), "t_end": (1.0, 4.0)},
    "train_buffers": {"n_wagons": (3, 10), "k": (2e6, 1e8), "speed": (0.5, 3.0), "t_end": (1.0, 3.0)},
}
WIDE = 10.0  # ranges whose ends differ by a larger factor are drawn log-uniformly


def drawn(seed: int = SEED) -> tuple[str, ...]:
    """Return specs of ``EACH`` random scenes of every family and ``EACH_OF_WING`` of the wing, reproducible by ``seed``."""
    random = np.random.default_rng(seed)
    specs = []
    for families, each in ((FAMILIES, EACH), (WING, EACH_OF_WING)):
        for family, ranges in families.items():
            for _ in range(each):
                values = ", ".join(f"{name}={_value(random, *ends)}" for name, ends in ranges.items())
                specs.append(f"{family}({values})")
    return tuple(specs)


def family_of(spec: str) -> str:
    """Return the problem's name in a spec, without its parameters."""
    return spec.partition("(")[0]


def _value(random: np.random.Generator, low: float, high: float) -> str:
    """Draw one parameter as text with three digits: whole numbers, or reals, log-uniform in wide ranges."""
    if isinstance(low, int) and isinstance(high, int):
        return str(int(random.integers(low, high + 1)))
    if 0 < WIDE * low < high:
        return f"{10 ** random.uniform(np.log10(low), np.log10(high)):.3g}".replace("e+0", "e")
    return f"{random.uniform(low, high):.3g}"
