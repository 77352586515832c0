"""What the extended form adds: directions that only reactions act in, and a curved guide."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.special import ellipk

from hhtbench.arguments import Matrix, Vector
from hhtbench.evidence import Row
from hhtbench.protocol import System, parameter
from solvers.hht.solver import HHT
from solvers.hht.step.state import State
from solvers.hht.verify.closed import invariants_error, roots, swing_of
from solvers.hht.verify.orders import ALPHAS, NAMES
from solvers.hht.verify.vibration import (
    STEP,
    Scene,
    measured_matrix,
    read_swing,
    run,
    take_step,
)
from solvers.hht.verify.vibration_rows import agreement_row, method_name

AMPLITUDE = 0.02  # [rad] of the bead; the next terms in it are 1e-4 of those of w h = 0.1
BENT = 0.01  # relative agreement of the bead with the oscillator, terms in its amplitude included
SILENT = 1e-5  # change of q, v and of multipliers that a normal error of one in a0 may leave
EXACT = 1e-12  # of invariants: roundoff


class Bead(System):
    """A bead of 1 kg on a circle of 1 m, pulled to the vertical line through its centre by a spring."""

    omega: Any = parameter(doc="sqrt(k/m) [rad/s]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """(2,)."""
        return jnp.stack([-(self.omega**2) * q[0], 0.0 * q[1]])

    def constraint(self, t: Any, q: Any) -> Any:
        """(1,)."""
        return jnp.stack([(q @ q - 1.0) / 2.0])


def bead_row(method: dict[str, Any]) -> Row:
    """Damping and period of the swinging bead at w h = 0.1 against its own period, ``4 K(sin^2 A) / w``, and (H18)."""
    frequency, periods = 0.1, 20
    omega = frequency / STEP
    start = np.array([np.sin(AMPLITUDE), -np.cos(AMPLITUDE)])
    steps = int(np.ceil(periods * 2.0 * np.pi / frequency))
    solution = run(HHT(Bead(omega=omega), **method), start, np.zeros(2), steps, "bead")
    real = np.pi * omega / (2.0 * ellipk(np.sin(AMPLITUDE) ** 2))
    found = read_swing(solution, _angle, real)
    alpha = method["alpha"]
    claim = f"bead on a circle, {method_name(method)}, alpha = {NAMES[alpha]}, w h = 0.1, {periods} periods"
    return agreement_row("damping/bead", claim, found, swing_of(roots(alpha, frequency, 0.0), frequency), BENT)


def _angle(q: Matrix, v: Matrix) -> tuple[Vector, Vector]:
    return np.arctan2(q[:, 0], -q[:, 1]), v[:, 1] * q[:, 0] - v[:, 0] * q[:, 1]


def ringing_row(scene: Scene, methods: Iterable[dict[str, Any]]) -> Row:
    """A normal error of one in a0 leaves q, v and the multipliers of later steps next to unchanged.

    The multipliers of the step itself take it up.  With velocity constraints q keeps ``(alpha h)^2 / 4`` of it and later
    multipliers the force of a spring stretched by that.
    """
    states, multipliers = 0.0, 0.0
    for method in methods:
        for alpha in (0.0, -0.3):
            honest, wrong = (_steps(scene, {**method, "alpha": alpha}, error) for error in (0.0, 1.0))
            for i, (a, b) in enumerate(zip(honest, wrong, strict=True)):
                states = max(states, _largest(a.q - b.q), _largest(a.v - b.v))
                if i:
                    size = _largest(np.concatenate([a.lam, a.mu]))
                    multipliers = max(multipliers, _largest(np.concatenate([a.lam - b.lam, a.mu - b.mu])) / size)
    return Row(
        id=f"ringing/{scene.name}",
        claim=f"{scene.name}, every b and reaction, alpha = 0 and -0.3, h = {STEP:g}: what an error of 1 across in a0 does "
        "to q, v of the next five steps, and (relative) to the multipliers after the first",
        measured=f"{states:.1e}, {multipliers:.1e}",
        bound=f"< {SILENT:g}",
        passed=max(states, multipliers) < SILENT,
    )


def _steps(scene: Scene, method: dict[str, Any], error: float) -> list[State]:
    """Five states after a start with ``error`` [m/s^2] across the free direction in a0."""
    hht = HHT(scene.system(0.1 / STEP, 0.0), **method)
    hht.init_step(0.0, scene.free, np.zeros(3), step=STEP)
    hht.restart(replace(hht.state, a=hht.state.a + error * scene.across, h=STEP))
    states = []
    for _ in range(5):
        take_step(hht, scene.name)
        states.append(hht.state)
    return states


def stiff_row(scene: Scene, frequency: float) -> Row:
    """Springs as stiff across the guides as along: a step is right, or it tells that it failed."""
    worst, told = 0.0, 0
    for alpha in ALPHAS:
        try:
            matrix = measured_matrix(scene, {"alpha": alpha}, frequency, 0.0)
        except RuntimeError:
            told += 1
            continue
        worst = max(worst, invariants_error(matrix, alpha, frequency, 0.0))
    return Row(
        id=f"stiff/{scene.name}",
        claim=f"{scene.name}, w h = {frequency:g}, zeta = 0, {len(ALPHAS)} alphas: trace, minors, determinant where steps "
        "succeed; how many tell a failure",
        measured=f"{worst:.1e}, {told}",
        bound=f"< {EXACT:g}, any number",
        passed=worst < EXACT,
    )


def _largest(x: Vector) -> float:
    return float(np.abs(x).max())
