"""Reactions that depend on velocities, (H50): orders, drift, declared derivatives."""

import re

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.system import NumpySystem
from hhtbench.solution.result import Status
from solvers.hht import HHT

MU, SPEED, END = 0.3, 2.0, 2.0


def friction_factor(xp, v):
    """Of lam: the direction against v."""
    return MU * v / xp.sqrt(v[0] ** 2 + v[1] ** 2)


class Bead(hb.System):
    """Unit mass on a ring of radius 1 without gravity; Coulomb's friction, which never stops what moves by itself alone."""

    def force(self, t, q, v):
        return jnp.zeros(2)

    def constraint(self, t, q):
        return jnp.stack([(q @ q - 1.0) / 2.0])

    def reaction(self, t, q, v, lam):
        return -lam[0] * (q + friction_factor(jnp, v))


class Held(Bead):
    """The same, with friction by the size of the multiplier: what errs by as much both ways does not cancel in it."""

    def reaction(self, t, q, v, lam):
        return -lam[0] * q - jnp.abs(lam[0]) * friction_factor(jnp, v)


def bead_at(t):
    """q, v (2,) and lam (1,): the speed obeys u' = -mu u^2, since the ring holds the bead by u^2."""
    u, angle = SPEED / (1.0 + MU * SPEED * t), np.log1p(MU * SPEED * t) / MU
    q = np.array([np.cos(angle), np.sin(angle)])
    return {"q": q, "v": u * np.array([-q[1], q[0]]), "lam": np.array([u * u])}


def reaction_jacobians(t, q, v, lam):
    size = np.sqrt(v @ v)
    by_v = -lam[0] * MU * (np.eye(2) / size - np.outer(v, v) / size**3)
    return -lam[0] * np.eye(2), by_v, -(q + friction_factor(np, v))[:, None]


NUMPY = {
    "force": lambda t, q, v: np.zeros(2),
    "force_jacobians": lambda t, q, v: (np.zeros((2, 2)), np.zeros((2, 2))),
    "constraint": lambda t, q: np.array([(q @ q - 1.0) / 2.0]),
    "constraint_jacobian": lambda t, q: q[None],
    "constraint_acceleration": lambda t, q, v: np.array([v @ v]),
    "reaction": lambda t, q, v, lam: -lam[0] * (q + friction_factor(np, v)),
    "reaction_jacobians": reaction_jacobians,
}
BEAD = Bead()
METHODS = [
    {"alpha": 0.0},
    {"alpha": -0.3, "b": 0.3},
    {"alpha": -0.15, "reaction": "predictor"},
    {"alpha": -0.15, "reaction": "midpoint"},
]


def solved(system, steps, **method):
    solution = HHT(system, **method).solve((0.0, END), [1.0, 0.0], [0.0, SPEED], steps=steps)
    assert solution.success, solution.message
    return solution


def drift(solution):
    """Largest residuals of both levels, the radius and the speed being of size one."""
    position = np.sum(solution.q**2, axis=1) - 1.0
    return max(np.max(np.abs(position)), np.max(np.abs(np.sum(solution.q * solution.v, axis=1))))


def errors(solution):
    """At the end, of q, v and lam; of the last step's multipliers at its two ends, and of their mean at its middle."""
    exact, last = bead_at(END), solution.steps_data
    found = {name: np.linalg.norm(getattr(solution, name)[-1] - exact[name]) for name in exact}
    ends = {"start": last.lam_start[-1], "end": last.lam_end[-1]}
    ends["middle"] = (ends["start"] + ends["end"]) / 2
    for name, part in (("start", 1.0), ("end", 0.0), ("middle", 0.5)):
        found[name] = abs(ends[name][0] - bead_at(END - part * last.h[-1])["lam"][0])
    return found


def orders(runs, names=("q", "v", "lam")):
    """Of the errors ``names``, from the last two runs, whose steps are halved."""
    before, after = (errors(run) for run in runs[-2:])
    return [np.log2(before[name] / after[name]) for name in names]


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_friction_keeps_order_two_and_both_levels(method):
    """(H50): a velocity off by O(h) in R1 would leave order one in v."""
    runs = [solved(BEAD, steps, **method) for steps in (400, 800)]
    assert orders(runs) == pytest.approx([2.0, 2.0, 2.0], abs=0.05)
    assert max(map(drift, runs)) < 1e-12


@pytest.mark.parametrize("method", METHODS[1:3], ids=str)
def test_plain_callables_with_declared_jacobians_make_the_same_steps(method):
    wanted, found = (solved(system, 100, **method) for system in (BEAD, NumpySystem(**NUMPY)))
    for name in ("q", "v", "lam"):
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), rtol=1e-11, atol=1e-11)
    assert found.counters.newton_iterations == wanted.counters.newton_iterations


def test_a_wrong_derivative_by_v_is_found_by_check_and_replaced_in_a_solve():
    def doubled(t, q, v, lam):
        by_q, by_v, by_lam = reaction_jacobians(t, q, v, lam)
        return by_q, 2.0 * by_v, by_lam

    wrong = NUMPY | {"reaction_jacobians": doubled}
    problem = hb.Problem(name="bead", system=NumpySystem(**wrong), t_span=(0, END), q0=[1, 0], v0=[0, SPEED])
    failed = {row.id for row in hb.check(problem).rows if row.passed is False}
    assert failed == {"derivative/reaction_v"}
    with pytest.warns(UserWarning, match="declared reaction_jacobians disagrees"):
        assert errors(solved(NumpySystem(**wrong), 100))["v"] < 1e-3


def test_jacobians_of_a_reaction_without_its_velocity_are_refused():
    short = NumpySystem(**NUMPY | {"reaction_jacobians": lambda t, q, lam: (np.eye(2), q[:, None])})
    with pytest.raises(ProblemError, match=re.escape("reaction takes (t, q, v, lam), so reaction_jacobians must")):
        HHT(short).solve((0.0, END), [1.0, 0.0], [0.0, SPEED], step=0.1)
    pair = NumpySystem(**NUMPY | {"reaction_jacobians": lambda t, q, v, lam: (np.eye(2), q[:, None])})
    with pytest.raises(TypeError, match="reaction_jacobians must return three matrices of shapes"):
        HHT(pair).solve((0.0, END), [1.0, 0.0], [0.0, SPEED], step=0.1)


def test_redundant_constraints_with_friction_end_in_a_status():
    rows = {
        "constraint": lambda t, q: np.full(2, (q @ q - 1.0) / 2.0),
        "constraint_jacobian": lambda t, q: np.stack([q, q]),
        "constraint_acceleration": lambda t, q, v: np.full(2, v @ v),
        "reaction_jacobians": None,
    }
    solution = HHT(NumpySystem(**NUMPY | rows)).solve((0.0, END), [1.0, 0.0], [0.0, SPEED], step=0.1)
    assert solution.status is Status.redundant_constraints


PULL, WEIGHT = 1.0, 9.81  # [N] on 1 kg


class Block(hb.System):
    """A block that friction MU tanh(v/width) holds against PULL: it creeps at the speed at which both are equal."""

    width: object = hb.parameter(1e-4)

    def force(self, t, q, v):
        return jnp.array([PULL, -WEIGHT])

    def constraint(self, t, q):
        return jnp.stack([q[1]])

    def reaction(self, t, q, v, lam):
        return lam[0] * jnp.stack([MU * jnp.tanh(v[0] / self.width), -1.0])


def off_creeping(width, reaction, **request):
    """What the block's speed is off at 3 s, in widths."""
    found = HHT(Block(width=width), reaction=reaction).solve((0.0, 3.0), [0.0, 0.0], [1.0, 0.0], **request)
    assert found.success, found.message
    return abs(found.v[-1, 0] / width - np.arctanh(PULL / (MU * WEIGHT)))


@pytest.mark.parametrize(("width", "fixed", "coarse"), [(1e-4, 0.002, 0.1), (1e-6, 0.05, 0.05)])
def test_a_block_that_sticks_creeps_at_its_speed_with_the_trapezoidal_choices(width, fixed, coarse):
    assert off_creeping(width, "implicit", steps=300) < fixed
    assert off_creeping(width, "implicit", rtol=1e-3) < coarse
    assert off_creeping(width, "implicit", rtol=1e-5) < 1e-3


def test_the_midpoint_choice_rings_in_long_steps_as_told_and_not_where_errors_are_controlled():
    assert off_creeping(1e-6, "midpoint", steps=300) > 1e3
    assert off_creeping(1e-6, "midpoint", rtol=1e-3) < 2.0
    assert off_creeping(1e-6, "midpoint", rtol=1e-5) < 1e-3


class Incline(hb.System):
    """A box that slides down an incline of 0.1 rad and settles where friction holds it."""

    def force(self, t, q, v):
        return jnp.array([0.0, -WEIGHT])

    def constraint(self, t, q):
        return jnp.stack([q[1] * jnp.cos(0.1) - q[0] * jnp.sin(0.1)])

    def reaction(self, t, q, v, lam):
        friction = 0.3 * jnp.abs(lam[0]) * jnp.tanh(v / 1e-2)
        return lam[0] * jnp.array([jnp.sin(0.1), -jnp.cos(0.1)]) - friction


@pytest.mark.parametrize("step", [1e-2, 1e-3])
@pytest.mark.parametrize("offset", [0.0, 1.0, 10.0])
def test_what_has_settled_is_not_said_to_be_moved_by_roundoff(offset, step):
    """It no longer accelerates: any roundoff is more than what it changes v by."""
    along = np.array([np.cos(0.1), np.sin(0.1)])
    solution = HHT(Incline()).solve((0.0, 2.0), offset * along, along, step=step)
    assert solution.success, solution.message
