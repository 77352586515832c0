"""Stiffness, masses, ranks of matrices and of constraints at their extremes (rows P1 to P6)."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.conformance.scenes.linkages import DoublePendulum, double_pendulum_angles
from hhtbench.studies.acceptance.asked import ALPHAS, Asked
from hhtbench.studies.acceptance.callbacks import FUNCTIONS
from hhtbench.studies.acceptance.rows import Finding, bounded, every, row
from hhtbench.studies.acceptance.scenes import Q0, V0, Rod, apart, ends, plane, problem

STATUS = hb.Status


@row(
    "P1",
    "spring of 1e2..1e14 N/m on a pendulum at fixed h = 1e-3",
    "success, at most 6 Newton iterations a step, error at most 1e-3",
)
def stiffness(asked: Asked) -> Finding:
    """Against the rigid rod from 1e8 on; below that against a run with a tenth of the step. By tolerance for the others."""
    errors, iterations, faults = {}, 0.0, {}
    rigid = hb.load_problem("stiff_spring_pendulum(stiffness=inf)").reference
    for power in (2, 4, 6, 8, 10, 12, 14):
        given = hb.load_problem(f"stiff_spring_pendulum(stiffness=1e{power})")
        times = np.asarray(rigid["t"])  # type: ignore[index]
        request: dict[str, Any] = {"step": 1e-3} if asked.is_hht else {"rtol": 1e-5}
        found = asked.solve(given, **request, t_eval=times)
        faults[f"1e{power}"] = ends(found, STATUS.success)
        if not found.success:
            continue
        finer = {"step": 1e-4} if asked.is_hht else {"rtol": 1e-8}
        exact = rigid["q"] if power >= 8 else asked.solve(given, **finer, t_eval=times).q  # type: ignore[index]
        errors[power] = float(np.abs(found.q - exact).max() / np.max(given.scales.q))
        iterations = max(iterations, (found.counters.newton_iterations or 0) / max(found.counters.steps_accepted or 1, 1))
        if errors[power] > 1e-3:
            faults[f"1e{power}"] = f"error {errors[power]:.1e}"
    faults["iterations"] = "" if iterations <= 6 or not asked.is_hht else f"{iterations:.1f} a step"
    return every(
        faults, f"largest error {max(errors.values(), default=np.nan):.1e}, at most {iterations:.2g} iterations a step"
    )


@row(
    "P2",
    "lower mass of a double pendulum 1e-8..1e8 times the upper one; fixed h = 1e-3",
    "success, error at most 1e-3; of HHT with b = 0, from where (H33) forbids h = 1e-3, or the tension's vibration named",
    long=True,
)
def mass_ratios(asked: Asked) -> Finding:
    """Straight at the start; against DOP853 on the angles' own equations."""
    faults, steps, worst = {}, {}, 0.0
    for power in (-8, -6, -4, -2, 0, 2, 4, 6, 8):
        given = problem(DoublePendulum(ratio=10.0**power), *DoublePendulum.straight(0.5), (0.0, 1.0))
        exact, _ = DoublePendulum.bent(*double_pendulum_angles(0.5, 10.0**power, 1.0))
        for way, request in asked.ways().items():
            finer = {**request, "step": 1e-3} if "step" in request else request
            found = asked.solve(given, **finer, max_num_steps=50_000)
            case = f"1e{power} {way}"
            told = (STATUS.newton_failed, STATUS.max_steps) if asked.is_hht and _forbidden(10.0**power) else ()
            carried = () if found.success else ("onstraint forces carry a vibration",)
            faults[case] = ends(found, STATUS.success, *told, words=carried)
            steps[case] = found.counters.steps_accepted or 0
            if found.success:
                error = float(np.abs(found.q[-1] - exact).max())
                worst = max(worst, error)
                faults[case] = "" if error <= 1e-3 else f"error {error:.1e}"
    return every(faults, f"largest error {worst:.1e}, at most {max(steps.values())} steps")


def _forbidden(ratio: float) -> bool:
    """Whether (H33) forbids steps of 1e-3 s with b = 0, which is the default."""
    return bool(1e-3 * DoublePendulum.fastest(ratio) > 2.0)


class MasslessAngle(hb.System):
    """The unit pendulum with its angle as a third coordinate that has no mass."""

    mass_matrix: Any = hb.parameter((1.0, 1.0, 0.0))

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Weight."""
        return jnp.stack([0.0 * t, -9.81 + 0.0 * t, 0.0 * t])

    def constraint(self, t: Any, q: Any) -> Any:
        """Place and angle agree."""
        return jnp.stack([q[0] - jnp.sin(q[2]), q[1] + jnp.cos(q[2])])


@row("P3", "singular M, regular KKT matrix", "result, error at most 1e-6")
def singular_mass(asked: Asked) -> Finding:
    """A pendulum with its angle as a coordinate without mass; 4000 steps, or a tolerance of 1e-8."""
    given = problem(MasslessAngle(), [*Q0, 1.0], [*V0, 0.5], (0.0, 1.0))
    bare = problem(Rod(), Q0, V0, (0.0, 1.0))
    worst = 0.0
    for alpha, request in [(x, {"steps": 4000}) for x in ALPHAS] if asked.is_hht else [(None, {"rtol": 1e-8})]:
        found = asked.solve(given, alpha=alpha, **request)
        if not found.success:
            return Finding(measured=ends(found, STATUS.success), holds=False)
        exact = hb.solve(bare, "scipy(method='DOP853')", rtol=1e-12, atol=1e-13)
        worst = max(
            worst, float(np.abs(found.q[-1, :2] - exact.q[-1]).max()), float(np.abs(found.v[-1, :2] - exact.v[-1]).max())
        )
    return bounded(worst, 1e-6, "error")


@row("P4", "singular KKT matrix: a coordinate with neither mass nor constraint", "singular_iteration_matrix that names it")
def singular_matrix(asked: Asked) -> Finding:
    """Constant and as a function."""
    masses: dict[str, Any] = {"constant": [1.0, 0.0], "function": lambda t, q: np.diag([1.0, 0.0])}
    faults = {}
    for case, mass in masses.items():
        given = problem(hb.NumpySystem(mass_matrix=mass, force=FUNCTIONS["force"]), Q0, V0)
        for way, request in asked.ways().items():
            faults[f"{case} {way}"] = ends(asked.solve(given, **request), STATUS.singular_iteration_matrix, words=("mass",))
    return every(faults)


@row("P5", "a constraint twice, also times 3.7, times 1e-8", "y, z, lam of least norm right, or redundant_constraints")
def duplicated(asked: Asked) -> Finding:
    """Against the single row."""
    faults, worst = {}, 0.0
    for way, request in asked.ways().items():
        right = asked.solve(problem(plane(), Q0, V0, (0.0, 0.3)), **request)
        for factor in (1.0, 3.7, 1e-8):
            rows = np.array([1.0, factor])
            twice = plane(
                constraint=lambda t, q, rows=rows: rows * (q @ q - 1) / 2,
                constraint_jacobian=lambda t, q, rows=rows: rows[:, None] * q,
            )
            found = asked.solve(problem(twice, Q0, V0, (0.0, 0.3)), **request)
            fault = ends(found, STATUS.success, STATUS.redundant_constraints)
            if found.success:
                least, own = right.lam[-1, 0] * rows / (rows @ rows), found.lam[-1]
                worst, apart_lam = max(worst, apart(found, right)), float(np.abs(own / least - 1.0).max())
                fault = "" if apart(found, right) <= 1e-5 else f"off by {apart(found, right):.1e}"
                fault = fault or ("" if apart_lam <= 1e-4 else f"multipliers {own}, those of least norm {least}")
            faults[f"x {factor:g} {way}"] = fault
    return every(faults, f"off by at most {worst:.1e}")


@row("P6", "contradictory constraints", "inconsistent_initial")
def contradictory(asked: Asked) -> Finding:
    """Two radii."""
    system = plane(
        constraint=lambda t, q: np.array([q @ q - 1, q @ q - 1.21]) / 2, constraint_jacobian=lambda t, q: np.stack([q, q])
    )
    return every(
        {
            way: ends(asked.solve(problem(system, Q0, V0), **x), STATUS.inconsistent_initial)
            for way, x in asked.ways().items()
        }
    )
