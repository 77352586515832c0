"""Problems with a closed solution: it satisfies motion, constraints and start, keeps the balance of energy."""

import jax
import numpy as np
import pytest

from hhtbench.catalogue.registry import list_problems, load_problem
from tests.problems.cases import CHANGED
from tests.problems.mechanics import compiled

CASES = [  # name, parameters, step of the time difference [s]: small against the fastest period in the solution
    ("jay_negrut_test1", {}, 2e-2),
    ("jay_negrut_pendulum", {}, 1e-3),
    ("jay_negrut_pendulum", {"m": 2.0, "L": 0.7, "k": 20.0, "c": 0.0, "g": 3.0, "z3": 6.0}, 5e-3),
    ("knife_edge", {}, 2e-2),
    ("knife_edge", {"m": 3.0, "I": 0.5, "incline": 0.2, "g": 5.0, "Om": 0.7}, 4e-2),
    ("rolling_disk3d_steady", {}, 1e-2),
    ("rolling_disk3d_steady", {"j0": 0.0}, 1e-2),
    ("rolling_disk3d_steady", {"m": 2.0, "R": 0.3, "g": 4.0, "theta": 0.5, "Om": 5.0, "j0": 0.3}, 5e-3),
    ("oscillator_chain", {}, 5e-4),
    ("oscillator_chain", {"n_masses": 2, "m": 2.0, "k": 50.0, "slow": 0.3, "fast": 0.4, "slow_speed": -1.0}, 5e-3),
    ("clamped_bar_impact", {}, 2e-3),
    ("clamped_bar_impact", CHANGED["clamped_bar_impact"] | {"n_elements": 3}, 1e-2),
    ("hf_linear_constrained", {}, 5e-4),
    ("hf_linear_constrained", CHANGED["hf_linear_constrained"], 5e-3),
    ("hf_linear_constrained", {"stiffness": 1e8}, 5e-6),
    ("chaplygin_sleigh", {}, 1e-2),
    ("chaplygin_sleigh", CHANGED["chaplygin_sleigh"], 2e-2),
    ("rolling_disk_incline", {}, 1e-2),
    ("rolling_disk_incline", CHANGED["rolling_disk_incline"], 2e-2),
    ("nonholonomic_particle", {}, 4e-2),
    ("nonholonomic_particle", CHANGED["nonholonomic_particle"], 4e-2),
    ("arevalo_circle", {}, 2e-3),
    ("arevalo_circle", {"c": 0.6, "t_start": 0.0, "t_end": 4.0}, 1e-2),
    ("bead_on_rotating_rod", {}, 5e-3),
    ("bead_on_rotating_rod", CHANGED["bead_on_rotating_rod"], 1e-2),
    ("pendulum_period2", {}, 5e-3),
    ("pendulum_period2", CHANGED["pendulum_period2"], 5e-3),
    ("simple_pendulum", {}, 5e-3),
    ("simple_pendulum", CHANGED["simple_pendulum"], 1e-2),
    ("redundant_pendulum", {}, 1e-2),
    ("redundant_pendulum", CHANGED["redundant_pendulum"], 1e-2),
    ("driven_coordinate", {}, 2e-2),
    ("driven_coordinate", CHANGED["driven_coordinate"], 5e-3),
    ("four_bars", {}, 5e-3),
]
cases = pytest.mark.parametrize(("name", "parameters", "h"), CASES)
FAST = ("arevalo_circle",)  # its velocity reaches 10 and its acceleration 100


def times(problem):
    """Inside the interval, at no special place of it."""
    start, end = problem.t_span
    length = 0.7 if problem.name == "four_bars" else end - start  # before the singular position
    early = {start + x * min(length, 1.0) for x in (0.13, 0.5, 0.91)}
    return sorted({start + x * length for x in (0.13, 0.47, 0.91)} | early)


def test_every_closed_solution_is_tried():
    assert {name for name in list_problems() if load_problem(name).exact is not None} == {name for name, _, _ in CASES}


@cases
def test_closed_solution_satisfies_the_equations_of_motion(make, mechanics, derivative, name, parameters, h):
    """Against differences of the solution in time; force, reaction and mass from the declared system."""
    problem = make(name, **parameters)
    system = mechanics(compiled(problem.system))
    for t in times(problem):
        q, v, lam, mu = problem.exact(t)
        qdot, vdot = (derivative(lambda s, i=i: problem.exact(s)[i], t, h) for i in (0, 1))
        inertia, applied = system.mass(t, q) @ vdot, np.asarray(system.system.force(t, q, v))
        reaction = system.reaction(t, q, v, lam, mu)
        size = max(np.abs(x).max() for x in (inertia, applied, reaction))
        np.testing.assert_allclose(qdot, v, rtol=0, atol=1e-10 * np.abs(v).max())
        np.testing.assert_allclose(inertia, applied + reaction, rtol=0, atol=1e-9 * size)


@cases
def test_closed_solution_satisfies_the_constraints_on_both_levels(make, mechanics, name, parameters, h):
    problem = make(name, **parameters)
    system = mechanics(compiled(problem.system))
    for t in (problem.t_span[0], *times(problem)):
        q, v, _, _ = problem.exact(t)
        size = (1 + np.abs(q).max() + np.abs(v).max()) ** (2 if name in FAST else 1)
        for rows in (system.g(t, q), system.position_rate(t, q, v), system.k(t, q, v)):
            np.testing.assert_allclose(rows, 0.0, rtol=0, atol=1e-14 * size)


LARGE_TERMS = ("clamped_bar_impact", "jay_negrut_pendulum", "rolling_disk3d_steady", "hf_linear_constrained")


@cases
def test_closed_solution_begins_at_the_start(make, name, parameters, h):
    problem = make(name, **parameters)
    start = problem.exact(problem.t_span[0])
    np.testing.assert_allclose(start.q, problem.q0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(start.v, problem.v0, rtol=0, atol=1e-14 if name in LARGE_TERMS else 1e-15)


BALANCED = [case[:2] for case in CASES if case[0] != "jay_negrut_test1"]  # which has no energy


@pytest.mark.parametrize(("name", "parameters"), BALANCED)
def test_energy_less_work_and_invariants_are_constant_on_the_closed_solution(make, name, parameters):
    """The work by Gauss' rule: 40 points over the interval, 160 for the pendulum that swings 20 times."""
    problem = make(name, **parameters)
    physics = compiled(problem.system)
    start, *later = (problem.t_span[0], *times(problem), problem.t_span[1])
    motion = lambda t: problem.exact(t)  # noqa: E731

    def work(end):
        if not hasattr(physics, "power"):
            return 0.0
        nodes, weights = np.polynomial.legendre.leggauss(160 if name == "jay_negrut_pendulum" else 40)
        points = start + (end - start) / 2 * (1 + nodes)
        return (end - start) / 2 * sum(w * float(physics.power(t, *motion(t))) for t, w in zip(points, weights, strict=True))

    first = float(physics.energy(start, *motion(start)[:2]))
    for t in later:
        energy = float(physics.energy(t, *motion(t)[:2]))
        size = abs(energy) if not hasattr(physics, "power") and abs(first) > 1e-6 else _size(problem, energy)
        np.testing.assert_allclose(energy - first, work(t), rtol=0, atol=1e-12 * size)
        if hasattr(physics, "invariants"):
            begun, now = physics.invariants(start, *motion(start)[:2]), physics.invariants(t, *motion(t)[:2])
            jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-13), now, begun)


def _size(problem, energy):
    return max(np.abs(np.ravel(problem.scales.v)).max() ** 2, abs(energy))
