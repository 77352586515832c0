"""The one-degree motions of the mechanisms that pass through singular positions."""

import math

import numpy as np
from scipy.integrate import solve_ivp

CRANK_START = (math.pi / 4, 4.0)  # angle, rate of the slider-crank
WINDOWS_START = (0.0, 1.0)  # of the windows, from the upright


def reduced(n=None):
    """One-degree equation of the smooth branch, (angle, rate) -> rates; n windows, or the slider-crank."""
    if n is not None:
        ratio = ((n + 1) / 2 + n) / ((n + 1) / 3 + n)  # moment of weight over moment of inertia, about the pivots
        return lambda t, y: [y[1], ratio * 9.81 * math.sin(y[0])]

    def crank(t, y):  # from (3 sin^2 a + 1/3) a'^2 + 9.81 sin a = const
        sin, cos = math.sin(y[0]), math.cos(y[0])
        return [y[1], -(6 * sin * y[1] ** 2 + 9.81) * cos / (6 * sin**2 + 2 / 3)]

    return crank


def integrated(rates, start, times):
    """States at ``times``, (k, size)."""
    return solve_ivp(rates, (0.0, times[-1]), start, method="DOP853", rtol=1e-13, atol=1e-13, t_eval=times).y.T


def crank_state(t):
    """(q, v) of the slider-crank of equal lengths on the smooth branch."""
    ((angle, rate),) = integrated(reduced(), CRANK_START, [t])
    slope = -2 * math.sin(angle) * rate
    return np.array([angle, -angle, 2 * math.cos(angle)]), np.array([rate, -rate, slope])
