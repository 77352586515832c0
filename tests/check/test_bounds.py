"""What bounds a derivative and a power: faults are found at every size of numbers, and what is right passes."""

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.checks.problem import check
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import NumpySystem, System, parameter
from tests.check.scenes import failed, row


def system(route, **functions):
    """The same functions, which take the array module first, as a System or as a NumpySystem."""
    if route == "numpy":
        return NumpySystem(**{name: lambda *a, f=f: f(np, *a) for name, f in functions.items()})
    return type("Made", (System,), {name: lambda self, *a, f=f: f(jnp, *a) for name, f in functions.items()})()


def at(made, q0, v0=None):
    q0 = np.array(q0, dtype=float)
    return Problem(name="made", system=made, t_span=(0.0, 1.0), q0=q0, v0=np.zeros(q0.size) if v0 is None else np.array(v0))


# derivatives

STEEP = {  # force and F_q, q0: features far smaller than the typical size of one, and digits that cancel
    "a magnet at 20 mm": (
        lambda xp, t, q, v: 1e-6 / (0.02 - q) ** 2,
        lambda q: np.diag(2e-6 / (0.02 - q) ** 3),
        [0.01, 0.3],
    ),
    "a soft wall of 1 mm": (
        lambda xp, t, q, v: -xp.tanh(q / 1e-3),
        lambda q: np.diag(-1e3 * (1 - np.tanh(q / 1e-3) ** 2)),
        [0.0, 2.0],
    ),
    "a wall 10 mm away": (
        lambda xp, t, q, v: 1e10 * xp.maximum(0.0, -q),
        lambda q: np.diag(np.where(q < 0, -1e10, 0.0)),
        [-0.01, 0.01],
    ),
    "a stiff spring of 1,000 km": (
        lambda xp, t, q, v: -1e10 * (1 - 1e6 / xp.sqrt(q @ q)) * q,
        lambda q: -1e10 * ((1 - 1e6 / np.sqrt(q @ q)) * np.eye(2) + 1e6 * np.outer(q, q) / np.sqrt(q @ q) ** 3),
        [6e5, 8e5],
    ),
}
FAULTS = {
    "10 %": lambda x: 1.1 * x,
    "factor 2": lambda x: 2.0 * x,
    "sign": lambda x: -x,
    "missing entry": lambda x: x * (np.arange(x.size).reshape(x.shape) > 0),
}


@pytest.mark.parametrize("name", STEEP)
@pytest.mark.parametrize("route", ["jax", "numpy"])
def test_a_right_derivative_passes_where_differences_of_the_usual_step_are_wrong(name, route):
    force, by_q, q0 = STEEP[name]
    assert failed(check(at(system(route, force=force), q0))) == []
    given = NumpySystem(force=lambda *a: force(np, *a), force_jacobians=lambda t, q, v: (by_q(q), None))
    assert row(check(at(given, q0)), "derivative/force_q").passed


@pytest.mark.parametrize("name", STEEP)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_wrong_derivative_is_found_there_too(name, fault):
    force, by_q, q0 = STEEP[name]
    wrong = lambda t, q, v: (FAULTS[fault](by_q(q)), None)  # noqa: E731 - one use
    given = NumpySystem(force=lambda *a: force(np, *a), force_jacobians=wrong)
    assert failed(check(at(given, q0)))[0] == "derivative/force_q"


def test_what_no_differences_can_judge_is_not_judged_unless_it_is_made_of_them():
    """A rod of 1,000 km in metres: its acceleration by second differences is noise, one that is declared may be right."""
    functions = {"force": lambda t, q, v: -q, "constraint": lambda t, q: np.array([(q @ q - 1e12) / 2])}
    place = [6e5, 8e5], [8.0, -6.0]
    derived = row(check(at(NumpySystem(**functions), *place)), "derivative/constraint_acceleration")
    assert derived.passed is False and "declare constraint_acceleration" in derived.measured
    given = NumpySystem(**functions, constraint_acceleration=lambda t, q, v: np.array([v @ v]))
    assert row(check(at(given, *place)), "derivative/constraint_acceleration").passed is None


# power


def drag(xp, t, q, v, c=0.5):
    return -c * xp.sqrt(v @ v) * v


SCENES = {  # functions and starts at rest, where energy and power both stand still
    "a pendulum in air": (
        {
            "force": lambda xp, t, q, v: xp.asarray([0.0, -9.81]) + drag(xp, t, q, v),
            "constraint": lambda xp, t, q: (q @ q - 1.0).reshape(1),
            "energy": lambda xp, t, q, v: v @ v / 2 + 9.81 * q[1],
        },
        lambda xp, t, q, v, lam, mu: -0.5 * xp.sqrt(v @ v) ** 3,
        [0.6, -0.8],
    ),
    "a driven oscillator of variable mass": (
        {
            "mass_matrix": lambda xp, t, q: (2.0 + xp.sin(q[0])) * xp.eye(1),
            "force": lambda xp, t, q, v: xp.sin(3 * t) - 4 * q - 0.1 * v - xp.cos(q) * v**2 / 2,
            "energy": lambda xp, t, q, v: (2.0 + xp.sin(q[0])) * v @ v / 2 + 2 * q @ q,
        },
        lambda xp, t, q, v, lam, mu: v[0] * xp.sin(3 * t) - 0.1 * v[0] ** 2,
        [0.0],
    ),
    "a stiff spring far away": (
        {
            "force": lambda xp, t, q, v: -1e10 * (q - 1e6) - 1e6 * v,
            "energy": lambda xp, t, q, v: v @ v / 2 + 5e9 * (q - 1e6) @ (q - 1e6),
        },
        lambda xp, t, q, v, lam, mu: -1e6 * v @ v,
        [1e6],
    ),
    "a skate with a motor": (
        {
            "force": lambda xp, t, q, v: xp.asarray([1.0, 0.0, 0.2]),
            "velocity_constraint": lambda xp, t, q, v: (v[0] * xp.sin(q[2]) - v[1] * xp.cos(q[2])).reshape(1),
            "energy": lambda xp, t, q, v: v @ v / 2 - q[0],
        },
        lambda xp, t, q, v, lam, mu: 0.2 * v[2],
        [0.0, 0.0, 0.0],
    ),
}


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("route", ["jax", "numpy"])
@pytest.mark.parametrize("factor", [1.0, -1.0, 1.01])
def test_a_power_of_the_wrong_sign_is_found_without_a_known_motion(name, route, factor):
    functions, power, q0 = SCENES[name]
    made = system(route, **functions, power=lambda *a: factor * power(*a))
    found = row(check(at(made, q0)), "energy/balance")
    assert found.passed is (factor == 1.0), found.measured


class Wall(System):
    """The made-up states beyond the wall have no energy: they are left out."""

    c: object = parameter(0.5, doc="[N s/m]")

    def force(self, t, q, v):
        return -self.c * v

    def energy(self, t, q, v):
        return v @ v / 2 + 0.0 * jnp.sqrt(1.001 - q[0])

    def power(self, t, q, v, lam, mu):
        return -self.c * v @ v


def test_made_up_states_where_the_energy_is_not_defined_are_left_out():
    assert row(check(at(Wall(), [1.0])), "energy/balance").passed
