"""Functions with errors of no function: both levels hold to roundoff, or the run ends with a status that names the noise."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.counting import Work
from hhtbench.drift import measure_drift
from hhtbench.result import Status
from problems.planar_chain import PlanarChain
from solvers._start import Place
from solvers.hht import HHT
from solvers.hht.run.noise import noise
from tests.hht.scenes import Q0, V0, circle, gravity, pendulum

pytestmark = pytest.mark.usefixtures("quick_xla")

SIZES = (1e-2, 1e-1, 1.0)
ASKED = {"steps": {"steps": 60}, "error": {"rtol": 1e-3, "max_num_steps": 150}}
ROUNDED = 1e-13  # of positions of 1 m, and of velocities of 1 m/s and more


def hashed(*arguments):
    """In [-1, 1), by the last bits of the arguments."""
    bits = 0x9E3779B97F4A7C15
    for number in np.concatenate([np.ravel(x) for x in arguments]).astype(float).view(np.uint64).tolist():
        bits = ((bits ^ number) * 0xBF58476D1CE4E5B9) % 2**64
        bits ^= bits >> 29
    return bits / 2**63 - 1.0


def drawn():
    """A normal number, another one in every call."""
    random = np.random.default_rng(3)
    return lambda *_: random.standard_normal()


def off(function, size, error):
    return lambda *arguments: function(*arguments) * (1.0 + size * error(*arguments))


def flat(t, q, v):
    return np.zeros((q.size, q.size)), np.zeros((q.size, q.size))


def skate(force):
    """A blade that pushes run down a slope while it turns; its row holds at the velocity level."""
    return hb.NumpySystem(
        force=force,
        force_jacobians=flat,
        velocity_constraint=lambda t, q, v: np.array([v[0] * np.sin(q[2]) - v[1] * np.cos(q[2])]),
        velocity_constraint_jacobian=lambda t, q, v: np.array([[np.sin(q[2]), -np.cos(q[2]), 0.0]]),
    )


def slope(t, q, v):
    return np.array([3.0, -9.81, 0.4])


def swinging(size, error):
    system = pendulum(force=off(gravity, size, error))
    return system, (Q0, V0), lambda s: (np.abs(np.sum(s.q**2, 1) - 1.0), np.abs(np.sum(s.q * s.v, 1)))


def skating(size, error):
    def levels(s):
        return np.zeros(1), np.abs(s.v[:, 0] * np.sin(s.q[:, 2]) - s.v[:, 1] * np.cos(s.q[:, 2]))

    return skate(off(slope, size, error)), (np.array([1.0, 0.0, 0.3]), np.array([0.0, 0.0, 1.0])), levels


@pytest.mark.parametrize(("engine", "asked"), [("compiled", "steps"), ("compiled", "error"), ("python", "steps")])
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("error", [hashed, drawn], ids=["of the state", "of the call"])
@pytest.mark.parametrize("scene", [swinging, skating])
def test_both_levels_hold_to_roundoff_beside_a_noisy_force(scene, error, size, engine, asked):
    system, start, levels = scene(size, error() if error is drawn else error)
    solution = HHT(system, engine=engine).solve((0.0, 0.6), *start, **ASKED[asked])
    position, velocity = levels(solution)
    assert position.max() < ROUNDED
    assert velocity.max() < ROUNDED
    assert solution.success or solution.status is Status.max_steps or "noise: two calls of force" in solution.message
    assert solution.t.size > 3


class Shaken(PlanarChain):
    """Its weight is off by up to ``size``, by the last digits of the state."""

    size: object = hb.parameter(0.0)

    def force(self, t, q, v):
        error = jax.lax.stop_gradient(jnp.sin(1e17 * jnp.sum(q) + 1e16 * jnp.sum(v)))
        return super().force(t, q, v) * (1.0 + self.size * error)


@pytest.mark.parametrize(("links", "span"), [(4, 0.2), (40, 0.01)], ids=["full matrix", "bands"])
def test_both_levels_of_a_chain_in_machine_code_hold_beside_a_noisy_force(links, span):
    problem = hb.load_problem(f"planar_chain(n_links={links})")
    chain = Shaken(m=problem.system.m, l=problem.system.l, size=1.0)
    solution = HHT(chain).solve((0.0, span), problem.q0, problem.v0, rtol=1e-3, max_num_steps=50)
    drift = measure_drift(problem, solution)
    assert solution.t.size > 3
    assert drift.position.max() < 1e-13
    assert drift.velocity.max() < 1e-12


@pytest.mark.parametrize("engine", ["compiled", "python"])
@pytest.mark.parametrize("error", [hashed, drawn()], ids=["of the state", "of the call"])
def test_constraints_that_have_noise_hold_as_well_as_it_allows(error, engine):
    system = pendulum(
        constraint=lambda t, q: circle(t, q) + 1e-9 * error(t, q), constraint_time_derivative=lambda t, q: np.zeros(1)
    )
    solution = HHT(system, engine=engine).solve((0.0, 0.5), Q0, V0, steps=50)
    assert solution.success, solution.message
    assert max(abs(circle(0.0, q)[0]) for q in solution.q) < 5e-9


@pytest.mark.filterwarnings("error")
def test_noise_is_not_taken_for_wrong_declared_derivatives():
    solution = HHT(pendulum(force=off(gravity, 1e-4, hashed))).solve((0.0, 1.0), Q0, V0, steps=100)
    assert solution.success or "noise: two calls of force" in solution.message


def test_little_noise_does_not_hide_wrong_declared_derivatives():
    """A force good to 1e-11, as of an inner iteration: its differences have digits enough, the wrong ones are given up."""
    wrong = {"force_jacobians": lambda t, q, v: (1e7 * np.ones((2, 2)), np.zeros((2, 2)))}
    system = pendulum(force=off(gravity, 1e-11, hashed), **wrong)
    with pytest.warns(UserWarning, match="declared force_jacobians"):
        solution = HHT(system).solve((0.0, 1.0), Q0, V0, steps=100)
    assert solution.success, solution.message


def diagnosed(force):
    """What is found of a ``force`` between two places far from the origin."""
    started = HHT(hb.NumpySystem(force=force)).begin(
        Place(0.0, np.array([1e4, 1e4 + 1.5]), np.array([0.01, -0.01])), (None, None), 0.1, Work()
    )
    return noise(started.engine, started.state, None, 0.1, 0.0)


def test_the_roundoff_of_a_stiff_spring_far_from_the_origin_is_no_noise():
    def pull(t, q, v):
        return 1e10 * (q[1] - q[0] - 1.0) * np.array([1.0, -1.0])

    assert diagnosed(pull) is None
    assert "some roundoffs apart" in diagnosed(off(pull, 1e-2, hashed)).text


def test_a_jump_some_roundoffs_beside_the_state_is_no_noise():
    beyond = 1e4 * (1.0 + 4 * np.finfo(float).eps)
    assert diagnosed(lambda t, q, v: np.where(q > beyond, 1.0, -1.0)) is None
