"""One step from exact data: local errors (Theorem 4.3), the starting guess (Remark 4.2), the amplification matrix (H18)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix
from hhtbench.evidence import Row
from hhtbench.protocol import System, parameter
from solvers.hht.equations.coefficients import Coefficients
from solvers.hht.solver import HHT
from solvers.hht.verify.measure import Case, Progress, below_row, slope
from solvers.hht.verify.orders import ALPHAS, NAMES

LOCAL_MARGIN = 0.1  # of local orders: the step cannot be as small as in a global order before roundoff
FREQUENCIES = (0.1, 1.0, 10.0, 1e3, 1e8)  # w h


def local_errors(case: Case, steps: tuple[float, ...], progress: Progress) -> list[Row]:
    """Orders of the local errors of q and v for each a0 of (H12)."""
    rows = []
    for alpha in ALPHAS:
        for start in ("f0", "shifted", "trapezoidal"):
            progress(f"local errors: {case.name} alpha = {NAMES[alpha]}, {start}")
            found = [_one_step(case, h, alpha=alpha, start=start) for h in steps]
            q, v = (slope(steps, [x[i] for x in found]) for i in (0, 1))
            wanted = 3.0 if alpha == 0.0 or start != "f0" else 2.0
            passed = abs(q - 3.0) <= LOCAL_MARGIN and abs(v - wanted) <= LOCAL_MARGIN
            rows.append(
                Row(
                    id=f"local/{case.name}",
                    claim=f"alpha = {NAMES[alpha]}, a0 = {start}: order of the local errors (Theorem 4.3)",
                    measured=f"q {q:.3f}, v {v:.3f}",
                    bound=f"q 3, v {wanted:g}, +- {LOCAL_MARGIN}",
                    passed=passed,
                )
            )
    return rows


def _one_step(case: Case, h: float, **method: Any) -> tuple[float, float]:
    p = case.problem
    hht = HHT(p.system, **method)
    t0 = p.t_span[0]
    hht.init_step(t0, p.q0, p.v0, step=h, lam_guess=p.lam_guess, mu_guess=p.mu_guess)
    _expect_success(hht, case.name)
    end = case.exact(t0 + h)
    return float(np.linalg.norm(hht.state.q - end.q)), float(np.linalg.norm(hht.state.v - end.v))


def _expect_success(hht: HHT, name: str) -> None:
    status = hht.step()
    if status.label != "success":
        raise RuntimeError(f"{name}: one step ended with {status.label}")


def multiplier_guess(case: Case, guesses: tuple[float, ...], h: float) -> Row:
    """Largest change of q1, v1 when the step's Newton iteration starts from other multipliers (Remark 4.2)."""
    p = case.problem
    ends, rejected = [], 0
    for guess in guesses:
        hht = HHT(p.system, alpha=-0.15, b=0.3)
        hht.init_step(p.t_span[0], p.q0, p.v0, step=h, lam_guess=p.lam_guess)
        hht.restart(replace(hht.state, lam=hht.state.lam * guess))
        _expect_success(hht, case.name)
        rejected += hht.counters.steps_rejected_newton or 0
        ends.append(np.concatenate([hht.state.q, hht.state.v]))
    worst = max(float(np.max(np.abs(end - ends[0]))) for end in ends)
    claim = (
        f"{case.name}: change of q1, v1 for starting multipliers times {', '.join(f'{g:g}' for g in guesses)} (Remark 4.2)"
    )
    if rejected:  # the engine then starts again from the acceleration level, whatever the guess
        return Row(id="guess", claim=claim, measured=f"{rejected} steps restarted", bound="0 restarted", passed=False)
    return below_row("guess", claim, worst, 1e-12)


class _Oscillator(System):
    """y'' = -w^2 y - 2 zeta w y'."""

    w: Any = parameter(1.0)
    zeta: Any = parameter(0.0)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """(1,)."""
        return -(self.w**2) * q - 2.0 * self.zeta * self.w * v


def amplification(progress: Progress) -> list[Row]:
    """Trace, principal minors and determinant of one step against the closed forms of (H18)."""
    rows = []
    for alpha in ALPHAS:
        progress(f"amplification: alpha = {NAMES[alpha]}")
        worst = 0.0
        for frequency in FREQUENCIES:
            for zeta in (0.0, 0.05):
                measured = _measured_matrix(alpha, frequency, zeta)
                worst = max(
                    worst,
                    *(
                        abs(a - b)
                        for a, b in zip(_invariants(measured), closed_invariants(alpha, frequency, zeta), strict=True)
                    ),
                )
        measured_at = "w h = 0.1 ... 1e8, zeta = 0 and 0.05"
        claim = f"alpha = {NAMES[alpha]}: trace, minors and determinant of one step on the oscillator, {measured_at}"
        rows.append(below_row("amplification", claim, worst, 1e-12))
    return rows


def _measured_matrix(alpha: float, frequency: float, zeta: float) -> Matrix:
    """The map of (y, h z, h^2 a) made by one step of h = 1 with w = ``frequency``."""
    system = _Oscillator(w=frequency, zeta=zeta)
    hht = HHT(system, alpha=alpha)
    columns = []
    for unit in np.eye(3):
        y, z, a = unit[:1], unit[1:2], unit[2:]
        hht.init_step(0.0, y, z, step=1.0)
        hht.restart(replace(hht.state, a=a, h=1.0))
        _expect_success(hht, "oscillator")
        columns.append(np.concatenate([hht.state.q, hht.state.v, hht.state.a]))
    return np.array(columns).T


def _invariants(a: Matrix) -> tuple[float, float, float]:
    minors = 0.5 * (np.trace(a) ** 2 - np.trace(a @ a))
    return float(np.trace(a)), float(minors), float(np.linalg.det(a))


def closed_invariants(alpha: float, frequency: float, zeta: float) -> tuple[float, float, float]:
    """Trace, sum of principal minors and determinant in closed form, (H18) with (H3)."""
    a, o, e = alpha, frequency, 1.0 + alpha
    d = 4.0 + (1.0 - a) ** 2 * e * o**2 + 4.0 * zeta * o * e * (1.0 - 2.0 * a)
    trace = (8.0 + (3.0 * a**3 - a - 2.0) * o**2 - 12.0 * zeta * o * a * (1.0 + 2.0 * a)) / d
    minors = (4.0 + (3.0 * a**3 + 3.0 * a**2 + a + 1.0) * o**2 - 4.0 * zeta * o * (6.0 * a**2 + 3.0 * a + 1.0)) / d
    return trace, minors, a * o * (e**2 * o - 4.0 * zeta * (1.0 + 2.0 * a)) / d


def amplification_matrix(alpha: float, frequency: float, zeta: float) -> Matrix:
    """The matrix (H18) itself, (3, 3), for the state (y, h z, h^2 a)."""
    c, o, e = Coefficients(alpha=alpha, b=0.0), frequency, 1.0 + alpha
    beta, gamma = c.beta, c.gamma
    rows = [
        [
            1.0 + alpha * beta * o**2 + 2.0 * e * gamma * zeta * o,
            1.0 + 2.0 * zeta * o * (e * gamma - beta),
            (1.0 - 2.0 * beta) / 2.0 + zeta * o * e * (gamma - 2.0 * beta),
        ],
        [
            -gamma * o**2,
            1.0 + e * (beta - gamma) * o**2 + 2.0 * alpha * gamma * zeta * o,
            (1.0 - gamma) + e * (2.0 * beta - gamma) * o**2 / 2.0,
        ],
        [-(o**2), -o * (e * o + 2.0 * zeta), o * e * ((2.0 * beta - 1.0) * o + 4.0 * zeta * (gamma - 1.0)) / 2.0],
    ]
    return np.array(rows) / (1.0 + 2.0 * zeta * gamma * e * o + beta * e * o**2)
