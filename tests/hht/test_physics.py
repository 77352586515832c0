"""Physics extremes: a singular mass, and parts a scene does not have (rows P3 and P14 of the acceptance matrix)."""

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.lowering import AccelerationLevel, ConstraintLevels
from hhtbench.lowering.dynamics import kkt, levels
from hhtbench.lowering.dynamics.jax_dynamics import JaxDynamics
from hhtbench.lowering.dynamics.numpy_dynamics import NumpyDynamics
from hhtbench.protocol import NumpySystem, System, parameter
from hhtbench.result import Status
from solvers.hht import HHT
from tests.hht.scenes import ALPHAS, ANGLE, GRAVITY, PENDULUM, Q0, SPEED, V0, Calls, circle, pendulum_at, tension_at


class MasslessAngle(System):
    """The unit pendulum with its angle as a third coordinate that has no mass: M = diag(1, 1, 0)."""

    mass_matrix: object = parameter((1.0, 1.0, 0.0))

    def force(self, t, q, v):
        return jnp.stack([0.0 * t, -GRAVITY + 0.0 * t, 0.0 * t])

    def constraint(self, t, q):
        return jnp.stack([q[0] - jnp.sin(q[2]), q[1] + jnp.cos(q[2])])


@pytest.mark.parametrize("alpha", ALPHAS)
def test_a_singular_mass_with_a_regular_kkt_matrix_gives_the_right_motion(alpha):
    start_q, start_v = [*Q0, ANGLE], [*V0, SPEED]
    solution = HHT(MasslessAngle(), alpha=alpha).solve((0.0, 1.0), start_q, start_v, steps=4000)
    assert solution.success, solution.message
    q, v = pendulum_at(solution.t)
    assert np.max(np.abs(solution.q[:, :2] - q)) <= 1e-6
    assert np.max(np.abs(solution.v[:, :2] - v)) <= 1e-6
    # the rod's pull: lam = S (sin, -cos) of the angle, S the tension m (l omega^2 + g cos)
    pull = tension_at(solution.q[:, :2], solution.v[:, :2])
    assert np.max(np.abs(solution.lam - pull[:, None] * solution.q[:, :2])) <= 1e-6


@pytest.mark.parametrize("mass", [[1.0, 0.0], lambda t, q: np.diag([1.0, 0.0])], ids=["constant", "function"])
def test_a_singular_mass_without_constraints_is_named(mass):
    system = NumpySystem(mass_matrix=mass, force=lambda t, q, v: np.array([0.0, -GRAVITY]))
    solution = HHT(system).solve((0.0, 0.1), Q0, V0, step=0.01)
    assert solution.status is Status.singular_iteration_matrix
    assert "mass matrix is singular" in solution.message


def test_a_mass_that_becomes_singular_without_constraints_is_named():
    system = NumpySystem(mass_matrix=lambda t, q: np.diag([1.0, max(0.0, 0.5 - t)]), force=lambda t, q, v: np.zeros(2))
    solution = HHT(system).solve((0.0, 1.0), Q0, V0, step=0.1)
    assert solution.status in (Status.singular_iteration_matrix, Status.nonfinite_callback)
    assert "mass_matrix" in solution.message
    assert 0.3 < solution.t[-1] < 0.55


def forbid(monkeypatch, owner, names):
    for name in names:

        def call(*arguments, name=name, **keywords):
            raise AssertionError(f"{name} was called")

        monkeypatch.setattr(owner, name, call)


MULTIPLIER_CODE = ["reaction", "reaction_jacobians", "constraint", "constraint_jacobian", "constraint_time_derivative"]
MULTIPLIER_CODE += ["constraint_velocity", "constraint_velocity_jacobian", "constraint_acceleration"]
VELOCITY_CODE = ["velocity_constraint", "velocity_constraint_jacobian", "velocity_constraint_position_jacobian"]
VELOCITY_CODE += ["velocity_constraint_acceleration", "velocity_reaction", "velocity_reaction_jacobians"]
MASS_CODE = ["mass", "mass_product_jacobian"]


class Free(System):
    """A falling particle that nothing holds: only ``force``."""

    gravity: object = parameter(GRAVITY)

    def force(self, t, q, v):
        return jnp.stack([0.0 * self.gravity, -self.gravity])


class Circle(System):
    """A pendulum: ``force`` and ``constraint``."""

    gravity: object = parameter(GRAVITY)

    def force(self, t, q, v):
        return jnp.stack([0.0 * self.gravity, -self.gravity])

    def constraint(self, t, q):
        return jnp.stack([(q @ q - 1.0) / 2.0])


FALLING = NumpySystem(force=lambda t, q, v: np.array([0.0, -GRAVITY]), force_jacobians=lambda t, q, v: (None, None))
HELD = NumpySystem(force=lambda t, q, v: np.array([0.0, -GRAVITY]), constraint=circle)


@pytest.mark.parametrize("system", [Free(), FALLING], ids=["jax", "numpy"])
def test_a_free_particle_calls_no_code_of_constraints_or_masses(system, monkeypatch):
    for dynamics in (JaxDynamics, NumpyDynamics):
        forbid(monkeypatch, dynamics, MULTIPLIER_CODE + VELOCITY_CODE + MASS_CODE)
    forbid(monkeypatch, AccelerationLevel, ["solve", "terms"])
    forbid(monkeypatch, kkt, ["kkt_terms"])
    forbid(monkeypatch, levels, ["level_terms"])
    forbid(monkeypatch, ConstraintLevels, ["at"])
    solution = HHT(system, alpha=-0.3).solve((0.0, 1.0), Q0, V0, step=0.05, calc_initcond=True)
    assert solution.success, solution.message
    t = solution.t[:, None]
    assert np.max(np.abs(solution.q - (Q0 + V0 * t + 0.5 * t**2 * [0.0, -GRAVITY]))) < 1e-13  # exact for a constant force
    assert solution.lam.shape == (len(solution.t), 0)


@pytest.mark.parametrize("system", [Circle(), HELD], ids=["jax", "numpy"])
def test_a_pendulum_calls_no_code_of_velocity_constraints(system, monkeypatch):
    for dynamics in (JaxDynamics, NumpyDynamics):
        forbid(monkeypatch, dynamics, [*VELOCITY_CODE, "mass_product_jacobian"])
    assert HHT(system, alpha=-0.3).solve((0.0, 0.1), Q0, V0, step=0.05).success


def test_what_is_only_measured_is_never_called_and_what_is_called_is_counted():
    calls = Calls()
    declared = {**PENDULUM, "energy": lambda t, q, v: 0.0, "invariants": lambda t, q, v: {}}
    solution = HHT(NumpySystem(**calls.wrap(declared))).solve((0.0, 0.5), Q0, V0, step=0.01)
    assert solution.success
    assert calls.count["energy"] == calls.count["invariants"] == 0
    assert calls.count["force"] <= solution.counters.residual_evaluations + solution.counters.output_evaluations
    assert calls.count["force_jacobians"] == solution.counters.jacobian_evaluations
    assert solution.counters.newton_iterations >= solution.counters.steps_accepted == 50
    assert solution.counters.factorisations <= solution.counters.jacobian_evaluations
