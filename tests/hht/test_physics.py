"""Parts that a scene does not have cost nothing (row P14 of the acceptance matrix), and a mass that becomes singular."""

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.lowering import AccelerationLevel, ConstraintLevels
from hhtbench.lowering.dynamics import kkt, levels
from hhtbench.lowering.dynamics.jax_dynamics import JaxDynamics
from hhtbench.lowering.dynamics.numpy_dynamics import NumpyDynamics
from hhtbench.protocol.system import NumpySystem, System, parameter
from hhtbench.solution.result import Status
from solvers.hht import HHT
from tests.hht.scenes import GRAVITY, Q0, V0, circle


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


class Circle(Free):
    """A pendulum: ``force`` and ``constraint``."""

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
