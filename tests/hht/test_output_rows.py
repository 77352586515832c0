"""Rows between steps and states at events hold both levels of the constraints, as steps do; what cannot is declared."""

import warnings
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol.events import Event
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import NumpySystem, System
from hhtbench.solution.result import Status
from problems.planar_chain import PlanarChain
from solvers.hht import HHT
from solvers.hht.verify.measure import violations
from solvers.hht.verify.outputs import outputs
from tests.hht.scenes import GRAVITY, Q0, SYSTEMS, V0
from tests.sample import slow

TIMES = np.linspace(0.0, 0.8, 38)
FEW = TIMES[::4]
SUBSET = ("simple_pendulum", "andrews", "redundant_pendulum", "knife_edge", "rolling_disk3d_steady", "driven_coordinate")
pytestmark = pytest.mark.filterwarnings("ignore:redundant constraints")


def of(system, q0=Q0, v0=V0, t_span=(0.0, 0.8)):
    return hb.Problem(name="p", system=system, t_span=t_span, q0=q0, v0=v0)


def off(problem, solution, *, events=False):
    """Largest scaled violation of either level at the rows, or at the first event's states."""
    at = solution
    rows = (at.t_events[0], at.q_events[0], at.v_events[0]) if events else (at.t, at.q, at.v)
    return max(violations(problem, *rows))


def massless():
    system = NumpySystem(
        mass_matrix=[1.0, 1.0, 0.0],
        force=lambda t, q, v: np.array([0.0, -GRAVITY, 0.0]),
        constraint=lambda t, q: np.array([q[0] - np.sin(q[2]), q[1] + np.cos(q[2])]),
        constraint_jacobian=lambda t, q: np.array([[1.0, 0.0, -np.cos(q[2])], [0.0, 1.0, -np.sin(q[2])]]),
    )
    return of(system, [*Q0, 1.0], [*V0, 0.5])


class Window(System):
    """A point on a line that a short while between two steps is no line: no state is on it, and its row is zero."""

    def force(self, t, q, v):
        return jnp.array([1.0, -GRAVITY])

    def constraint(self, t, q):
        return jnp.stack([jnp.where(jnp.abs(t - 0.055) < 2e-3, 1e-3, q[1])])


@pytest.mark.parametrize("spec", SUBSET)
def test_rows_and_events_hold_both_levels_and_errors_do_not_grow(spec):
    """A part of ``hhtbench verify outputs``: redundant rows, velocity constraints and drives among it."""
    rows = outputs(spec, tolerances=(1e-2, 1e-4))
    assert [row.passed for row in rows] == [True, True], [row.measured for row in rows]


class Doubled(PlanarChain):
    """A chain whose last joint is there twice."""

    def constraint(self, t, q):
        rows = super().constraint(t, q)
        return jnp.concatenate([rows, rows[-2:]])


class Across(PlanarChain):
    """A chain whose joints drag their rods along beside holding them: reactions are not normal to the constraints."""

    def reaction(self, t, q, lam):
        turned = jnp.pad(lam.reshape(-1, 2)[:, ::-1], ((0, 0), (0, 1))).ravel()
        return -jax.vjp(lambda x: self.constraint(t, x), q)[1](lam)[0] - 0.02 * turned


CHAIN = replace(hb.load_problem("planar_chain(n_links=60)"), t_span=(0.0, 0.05))


def chain_of(kind):
    return replace(CHAIN, system=kind(m=CHAIN.system.m, l=CHAIN.system.l))


SCENES = {
    "numpy": (of(SYSTEMS["numpy"]), TIMES, {}),
    "numpy, one by one": (of(SYSTEMS["numpy"]), FEW, {}),
    "plain Python": (of(SYSTEMS["jax"]), FEW, {"engine": "python"}),
    "singular mass": (massless(), TIMES, {}),
    "singular mass, one by one": (massless(), FEW, {}),
    "middle size": (replace(hb.load_problem("planar_chain(n_links=20)"), t_span=(0.0, 0.05)), np.linspace(0, 0.05, 38), {}),
    "large": (CHAIN, np.linspace(0, 0.05, 38), {}),
    "large, redundant rows": (chain_of(Doubled), np.linspace(0, 0.05, 38), {}),
    "large, reaction across the rows": (chain_of(Across), np.linspace(0, 0.05, 38), {}),
    "backward": (of(SYSTEMS["jax"], t_span=(0.8, 0.0)), TIMES[::-1], {}),
}


@pytest.mark.parametrize("scene", [slow(x) if x in ("large", "middle size") else x for x in SCENES])
def test_rows_hold_both_levels_by_every_route(scene):
    problem, times, options = SCENES[scene]
    solution = HHT(problem.system, **options).solve(problem.t_span, problem.q0, problem.v0, steps=20, t_eval=times)
    assert solution.status is Status.success
    plain = solution(times)
    assert off(problem, replace(solution, q=plain.q, v=plain.v)) > 1e-10
    assert off(problem, solution) < 1e-13


def test_rows_of_methods_that_hold_positions_alone_stay_as_they_are():
    """What drifts at steps must not look better between them."""
    problem, request = of(SYSTEMS["jax"]), {"steps": 20, "t_eval": TIMES}
    for solver, moved in {"hht_i3": False, "generalised_alpha(form=index3)": False, "rattle": True}.items():
        solution = hb.solve(problem, solver, **request)
        assert (solution.q.tobytes() != solution(TIMES).q.tobytes()) is moved, solver


@pytest.mark.parametrize("route", SYSTEMS)
@pytest.mark.parametrize("how", [{"step": 0.05}, {"rtol": 1e-3}], ids=str)
def test_states_at_recorded_events_hold_both_levels_in_a_run_and_by_hand(route, how):
    problem, lowest = of(SYSTEMS[route]), Event(lambda t, q, v: q[0] - 0.3)
    hht = HHT(SYSTEMS[route], events=lowest)
    solution = hht.solve((0.0, 0.8), Q0, V0, **how)
    assert solution.t_events[0].size == 1
    assert off(problem, solution, events=True) < 1e-14
    hht.init_step(0.0, Q0, V0, **how)
    while not hht.occurrences:
        assert hht.step(0.8) is Status.success
    (found,) = hht.occurrences
    there = replace(solution, t=np.array([found.t]), q=found.q[None], v=found.v[None])
    assert off(problem, there) < 1e-14


def test_what_no_state_meets_stays_as_interpolated_and_is_declared():
    """A row in a window that no step sees, where the constraint reads 1e-3 and its row is zero."""
    hht, times = HHT(Window()), [0.03, 0.055, 0.08]
    seen = Event(lambda t, q, v: t - 0.0551, name="inside")
    solution = HHT(Window(), events=seen).solve((0.0, 0.1), [0.0, 0.0], [0.5, 0.0], step=0.01, t_eval=times)
    assert solution.status is Status.success
    assert "At 1 rows no state near the interpolated one meets the constraints, first at t = 0.055" in solution.message
    assert "violated by up to 0.001 of their size" in solution.message
    assert "Event 'inside': At 1 rows no state" in solution.message
    free = hht.solve((0.0, 0.1), [0.0, 0.0], [0.5, 0.0], step=0.01)
    assert solution.q[1].tobytes() == free(0.055).q.tobytes()
    with pytest.warns(UserWarning, match="At 1 rows no state"):
        assert free(times, project=True).q[1].tobytes() == free(0.055).q.tobytes()


@pytest.mark.parametrize("t", [0.333, [0.333, 0.4]], ids=["scalar", "array"])
@pytest.mark.parametrize("route", SYSTEMS)
def test_dense_output_is_on_the_constraints_where_that_is_asked_for(route, t):
    problem, solution = of(SYSTEMS[route]), HHT(SYSTEMS[route]).solve((0.0, 0.8), Q0, V0, steps=20)
    plain, moved = solution(t), solution(t, project=True)
    assert plain.q.shape == moved.q.shape == (*np.shape(t), 2)
    assert np.abs(plain.q - moved.q).max() > 1e-9
    rows = replace(solution, t=np.atleast_1d(t), q=np.atleast_2d(moved.q), v=np.atleast_2d(moved.v))
    assert off(problem, rows) < 1e-14
    at_steps = solution(solution.t, project=True)
    assert at_steps.q.tobytes() == solution.q.tobytes()


AMPLITUDES = (1e-2, 1e-3, 1e-4)


class Links(System):
    """Two links [mm]."""

    length: float

    def force(self, t, q, v):
        return jnp.array([0.0, -9.81, 0.0, -9.81])

    def constraint(self, t, q):
        first, second = q[:2], q[2:] - q[:2]
        return jnp.stack([first @ first - self.length**2, second @ second - self.length**2])


class Displaced(System):
    """A rod of length one; q is the displacement of its end from hanging: g holds constants far larger than the motion."""

    def force(self, t, q, v):
        return jnp.array([0.0, -9.81])

    def constraint(self, t, q):
        return jnp.stack([q[0] ** 2 + (q[1] - 1.0) ** 2 - 1.0])


@pytest.mark.parametrize("engine", ["compiled", "python"])
def test_projected_methods_take_states_far_larger_than_the_scales(engine):
    """Roundoff of g_q v was taken for a projection that fails: scales are 1, the speeds 9e4."""
    links = Problem(name="links", system=Links(1e3), t_span=(0.0, 1.0), q0=[1e3, 0.0, 2e3, 0.0], v0=[0.0, 3e4, 0.0, 9e4])
    found = hb.solve(links, f"projected(method=DOP853, engine={engine})", rtol=1e-6)
    assert found.success
    assert np.abs(jax.vmap(links.system.constraint)(found.t, found.q)).max() < 1e-12 * 4e6


@pytest.mark.parametrize("amplitude", AMPLITUDES)
def test_rows_and_events_of_displacements_from_rest_are_on_the_constraints(amplitude):
    """They were called off the constraints, which only roundoff of g was."""
    a = amplitude
    start = [a, a * a / (1.0 + np.sqrt(1.0 - a * a))]
    hht = HHT(Displaced(), events=[Event(lambda t, q, v: q[0] - 0.3 * a)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = hht.solve((0.0, 3.0), start, [0.0, 0.0], rtol=1e-3, t_eval=np.linspace(0.0, 3.0, 50))
        dense = found(np.linspace(0.0, 3.0, 77), project=True)
    assert found.status is Status.success
    assert "constraints" not in found.message
    for q in (found.q, found.q_events[0], dense.q):
        assert np.abs(q[:, 0] ** 2 + (q[:, 1] - 1.0) ** 2 - 1.0).max() < 2e-15
