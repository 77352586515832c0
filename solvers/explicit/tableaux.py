"""Explicit Runge-Kutta methods by name, as SciPy's solver classes, and their coefficients for the compiled loop."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import integrate

from solvers.explicit.march import Method


class Tsit5(integrate.RK45):
    """Ch. Tsitouras, Computers and Mathematics with Applications 62 (2011) 770-775; without his interpolant.

    Order 5 with an error estimate of order 4, first same as last, as Dormand and Prince's.
    """

    C = np.array([0.0, 0.161, 0.327, 0.9, 0.9800255409045097, 1.0])
    A = np.array(
        [
            [0.0, 0.0, 0.0, 0.0, 0.0],
            [0.161, 0.0, 0.0, 0.0, 0.0],
            [-0.008480655492356989, 0.335480655492357, 0.0, 0.0, 0.0],
            [2.8971530571054935, -6.359448489975075, 4.3622954328695815, 0.0, 0.0],
            [5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525, 0.0],
            [5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401, -0.028269050394068383],
        ]
    )
    B = np.array([0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742, -3.290069515436081, 2.324710524099774])
    E = np.array(
        [
            0.001780011052226, 0.000816434459657, -0.007880878010262, 0.144711007173263, -0.582357165452555,
            0.458082105929187, -1 / 66,
        ]
    )  # fmt: skip


CLASSES: dict[str, Any] = {
    "DOP853": integrate.DOP853,
    "Tsit5": Tsit5,
    "RK45": integrate.RK45,
    "RK23": integrate.RK23,
}


def coefficients(name: str) -> Method:
    """Coefficients of the method ``name`` for the compiled loop."""
    of = CLASSES[name]
    stages = of.n_stages
    a = np.zeros((stages, stages))
    a[:, : of.A.shape[1]] = of.A[:stages]
    estimates = (of.E5, of.E3) if name == "DOP853" else (of.E, np.zeros(stages + 1))
    return Method(a, np.array(of.B), np.array(of.C[:stages]), np.array(estimates), -1.0 / (of.error_estimator_order + 1))
