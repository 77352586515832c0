"""Prescribed steps of changing length: what they amplify is told, (H53), and what they do no harm to is not."""

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.protocol import System, parameter
from hhtbench.result import Status
from solvers.hht import HHT
from solvers.hht.equations.coefficients import Coefficients
from solvers.hht.run.ratios import amplification, limit
from tests.hht.scenes import Q0, V0, Pendulum

STIFF = 1e8


class Springs(System):
    """A soft spring and a stiff one."""

    k: object = parameter(STIFF)
    u: object = parameter(0.0)

    def force(self, t, q, v):
        return jnp.stack([-q[0], -self.k * (q[1] - self.u * t)])


class Coupled(System):
    """Two unit masses on a stiff spring between them, in one slow motion."""

    def force(self, t, q, v):
        f = STIFF * (q[1] - q[0])
        return jnp.stack([-q[0] + f, -q[1] - f])


class Struck(System):
    """A soft spring, and a stiff one that is struck half way."""

    k: object = parameter(STIFF)

    def force(self, t, q, v):
        return jnp.stack([-q[0], -self.k * q[1] + 1e3 * jnp.exp(-(((t - 1.5) / 0.01) ** 2))])


class Ball(System):
    """Dropped on a spring of a stiff floor, seen from a lift."""

    u: object = parameter(0.0)

    def force(self, t, q, v):
        return jnp.stack([-1.0 + 1e4 * jnp.maximum(self.u * t - q[0], 0.0)])


def lengths(ratio, count=400, span=5.0):
    h = np.tile([1.0, ratio], count // 2)
    return span * h / h.sum()


def springs(steps, alpha=-0.3, off=1e-8):
    return HHT(Springs(), alpha=alpha).solve((0.0, 5.0), [1.0, off], [0.0, 0.0], steps=steps)


@pytest.mark.parametrize(("alpha", "ratio"), [(-0.3, 3.5), (-0.3, 8.0), (-0.05, 30.0), (-0.05, 50.0)])
def test_what_ratios_beyond_the_limit_make_grow_is_told(alpha, ratio):
    solution = springs(lengths(ratio), alpha)
    assert np.abs(solution.v[:, 1]).max() > 1e-2, "from 1e-4 m/s"
    assert solution.status is Status.unreliable
    assert f"change by up to {ratio:.3g} times" in solution.message
    assert "speeds of coordinates [1]" in solution.message
    assert solution.t.size == 401


@pytest.mark.parametrize("u", [0.0, 1.0, -1e3])
@pytest.mark.parametrize(("alpha", "ratio", "count"), [(-0.3, 4.0, 200), (-0.3, 3.5, 300), (-0.05, 30.0, 300)])
def test_what_grows_is_told_wherever_it_is_seen_from(u, alpha, ratio, count):
    steps = lengths(ratio, count, 5.0 * count / 400)
    solution = HHT(Springs(u=u), alpha=alpha).solve((0.0, steps.sum()), [1.0, 1e-10], [0.0, u], steps=steps)
    assert np.abs(solution.v[:, 1] - u).max() > 1e-2 * (1.0 + abs(u))
    assert solution.status is Status.unreliable
    assert "speeds of coordinates [1]" in solution.message


@pytest.mark.parametrize(("ratio", "count"), [(3.5, 100), (8.0, 20)])
def test_what_grows_beside_a_motion_of_the_same_coordinate_is_told(ratio, count):
    steps = lengths(ratio, count, 2.5 * count / 200)
    solution = HHT(Coupled(), alpha=-0.3).solve((0.0, steps.sum()), [1.0, 1.0 + 2e-8], [0.0, 0.0], steps=steps)
    assert np.abs(solution.v + np.sin(solution.t)[:, None]).max() > 0.1
    assert solution.status is Status.unreliable


def union(n, m, span):
    """The steps of two even grids together."""
    return np.diff(np.union1d(np.linspace(0.0, span, n + 1), np.linspace(0.0, span, m + 1)))


@pytest.mark.parametrize("u", [0.0, 1.0])
@pytest.mark.parametrize("steps", [lengths(10.0, 200, 2.0), lengths(4.0, 200, 2.0), union(200, 141, 2.0)])
def test_a_contact_is_not_told(steps, u):
    """A step in which v turns, and a start at rest."""
    for height in (0.4, 0.45, 0.5, 0.55):
        solution = HHT(Ball(u=u), alpha=-0.3).solve((0.0, steps.sum()), [height], [u], steps=steps)
        assert solution.v.max() > u + 0.5, "it is thrown back"
        assert solution.status is Status.success


@pytest.mark.parametrize(("omega", "n", "m"), [(300.0, 200, 141), (600.0, 100, 71)])
def test_what_a_blow_has_stirred_up_is_not_told(omega, n, m):
    """To and fro with the steps, which damp it."""
    steps = union(n, m, 3.0)
    solution = HHT(Struck(omega**2), alpha=-0.3).solve((0.0, 3.0), [1.0, 1e-7], [0.0, 0.0], steps=steps)
    speeds = np.abs(solution.v[:, 1])
    assert speeds[-30:].max() < 1e-3 < 0.5 < speeds.max()
    assert solution.status is Status.success


@pytest.mark.parametrize("alpha", [-0.05, -0.3])
def test_ratios_below_the_limit_are_fine_and_named(alpha):
    solution = springs(lengths(0.9 * limit(alpha)), alpha)
    assert solution.status is Status.success
    assert np.abs(solution.v[:, 1]).max() < 1e-2


@pytest.mark.parametrize("ratio", [0.001, 0.1, 10.0, 100.0])
def test_a_single_change_is_not_told(ratio):
    steps = np.repeat([1.0, ratio], 200)
    assert springs(5.0 * steps / steps.sum()).status is Status.success


def test_a_vibration_that_steps_have_not_made_grow_is_not_told():
    """Alpha = 0 keeps what is there, at every ratio."""
    solution = springs(lengths(10.0), alpha=0.0, off=1e-2)
    assert solution.status is Status.success
    assert np.abs(solution.v[:, 1]).max() > 10.0


@pytest.mark.parametrize("ratio", [10.0, 100.0])
def test_changing_steps_of_a_motion_without_fast_vibrations_are_not_told(ratio):
    solution = HHT(Pendulum(), alpha=-0.3).solve((0.0, 1.0), Q0, V0, steps=lengths(ratio, span=1.0))
    assert solution.status is Status.success


@pytest.mark.parametrize("alpha", [-0.05, -0.15, -0.3, -1 / 3])
def test_the_limit_is_where_the_steps_themselves_begin_to_amplify(alpha):
    """The step of the code on a spring that is far too stiff for it."""

    def grown(ratio):
        speeds = np.abs(
            HHT(Springs(1e16), alpha=alpha).solve((0.0, 5.0), [0.0, 0.0], [0.0, 1.0], steps=lengths(ratio)).v[:, 1]
        )
        return speeds[-100:].max() / speeds[100:200].max()

    assert grown(0.95 * limit(alpha)) < 1.0 < grown(1.05 * limit(alpha))


def test_mild_ratios_amplify_nothing():
    drawn = 1.5 ** np.random.default_rng(1).uniform(size=1_000)
    assert amplification(Coefficients(alpha=-1 / 3, b=0.0), drawn) < 20.0
