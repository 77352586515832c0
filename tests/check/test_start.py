"""The check and the solvers say the same of a start and of its mass matrix."""

import warnings

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.checks.problem import check
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import NumpySystem, System, parameter
from hhtbench.solution.request import Request
from hhtbench.solution.result import Status
from solvers import hht, ida
from solvers.hht import HHT
from tests.check.scenes import problem, row, skate


def pendulum(length):
    functions = {"force": lambda t, q, v: np.array([0.0, -9.81]), "constraint": lambda t, q: np.array([q @ q - length**2])}
    return functions, length * np.array([0.6, -0.8]), np.array([0.8, 0.6])


@pytest.mark.parametrize("length", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("level", ["position", "velocity"])
@pytest.mark.parametrize(("apart", "consistent"), [(3e-9, True), (3e-8, False)])
def test_check_and_solvers_judge_a_start_alike(length, scale, level, apart, consistent):
    """1e-9 m is nothing for a machine of one metre and much for one of a micrometre, whatever scales are declared."""
    functions, q0, v0 = pendulum(length)
    if level == "position":
        q0 = q0 * (1 + apart)
    else:
        v0 = v0 + 2 * apart * q0 / length
    made = problem(functions, q0=q0, v0=v0, scales=Scales(q=scale, v=scale))
    assert row(check(made), f"start/{level}").passed is consistent
    for solver in (hht.solver(), ida.solver()):
        ended = solver.solve(made, Request(rtol=1e-3, atol=1e-3 * length, max_num_steps=1)).status
        assert (ended is not Status.inconsistent_initial) is consistent


def test_at_rest_roundoff_is_consistent_for_check_and_solvers():
    """sin(pi) is not zero; at rest there is no velocity to measure it by."""
    functions = skate() | {"velocity_constraint": lambda t, q, v: np.array([v[1] - np.sin(np.pi) * q[0]])}
    del functions["velocity_constraint_jacobian"]
    made = problem(functions, q0=np.ones(3), v0=np.zeros(3))
    assert row(check(made), "start/velocity").passed
    assert HHT(made.system).solve((0.0, 0.1), made.q0, made.v0, step=0.1).success


class Weighed(System):
    """Two coordinates of very different mass."""

    mass: object = parameter(jnp.eye(2), doc="[kg]")

    def mass_matrix(self, t, q):
        return self.mass

    def force(self, t, q, v):
        return -q


@pytest.mark.parametrize(
    ("mass", "named"),
    [
        ([[2.0, 0.5], [0.25, 2.0]], "M[0, 1] = 0.5 and M[1, 0] = 0.25"),
        ([[1e6, 1e-4], [2e-4, 1e-6]], "M[0, 1] = 0.0001 and M[1, 0] = 0.0002"),
        ([[1e6, 1e-4], [1e-4, 1e-6]], ""),
    ],
)
@pytest.mark.parametrize("route", ["jax", "numpy"])
def test_a_mass_that_is_not_symmetric_is_said_with_its_entries(mass, named, route):
    """Relative to the two diagonal entries: the smaller mass has a symmetry of its own."""
    mass = np.array(mass)
    made = problem({"force": lambda t, q, v: -q, "mass_matrix": mass})
    if route == "jax":
        made = Problem(name="weighed", system=Weighed(mass), t_span=(0.0, 1.0), q0=np.ones(2), v0=np.zeros(2))
    found = row(check(made), "mass/symmetric")
    assert found.passed is not bool(named)
    assert named in str(found.measured)
    for solver in (hht.solver(), ida.solver(form="index1")):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            solver.solve(made, Request(rtol=1e-3, max_num_steps=1))
        said = [str(w.message) for w in caught if "not symmetric" in str(w.message)]
        assert (named in said[0] and "mass_matrix" in said[0]) if named else not said


class Turning(System):
    """A mass that moves with q, and an entry of it that has no counterpart."""

    skew: object = parameter(0.25, doc="[kg]")

    def force(self, t, q, v):
        return -q

    def mass_matrix(self, t, q):
        return jnp.array([[2.0 + q[0] ** 2, 0.5], [0.5 + self.skew, 2.0]])


def turning(skew):
    return lambda t, q: np.array([[2.0 + q[0] ** 2, 0.5], [0.5 + skew, 2.0]])


@pytest.mark.parametrize(
    ("route", "constrained", "skew"),
    [("jax", True, 0.25), ("jax", False, 0.0), ("numpy", False, 0.25), ("numpy", True, 0.0)],
)
def test_a_variable_mass_that_is_not_symmetric_at_the_start_is_said_once_by_solve(route, constrained, skew):
    functions = {"constraint": lambda t, q: q[:1] - 1.0} if constrained else {}
    if route == "jax":
        system = type("Bound", (Turning,), {name: lambda self, t, q, f=f: f(t, q) for name, f in functions.items()})(
            skew=skew
        )
    else:
        jacobian = {"constraint_jacobian": lambda t, q: np.array([[1.0, 0.0]])} if constrained else {}
        system = NumpySystem(force=lambda t, q, v: -q, mass_matrix=turning(skew), **functions, **jacobian)
    made = Problem(name="weighed", system=system, t_span=(0.0, 1.0), q0=np.ones(2), v0=np.zeros(2))
    for solver in (hht.solver(), ida.solver(form="index1")):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            solver.solve(made, Request(rtol=1e-3, max_num_steps=1))
        said = [str(w.message) for w in caught if "not symmetric" in str(w.message)]
        assert len(said) == (1 if skew else 0)
        assert all("M[0, 1] = 0.5 and M[1, 0] = 0.75" in text for text in said)
