"""Claims that hold for every problem, or for every one with a closed solution, energy or reference."""

import equinox as eqx
import jax
import numpy as np
import pytest

NAMES = ("jay_negrut_test1", "jay_negrut_pendulum", "andrews", "knife_edge", "rolling_disk3d_steady", "oscillator_chain")
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
]
cases = pytest.mark.parametrize(("name", "parameters", "h"), CASES)
TIMES = (0.13, 0.5, 0.91)  # inside every interval


@cases
def test_closed_solution_satisfies_the_equations_of_motion(make, mechanics, derivative, name, parameters, h):
    """Against differences of the solution in time; force, reaction and mass from the declared system."""
    problem = make(name, **parameters)
    system = mechanics(problem.system)
    for t in TIMES:
        q, v, lam, mu = problem.exact(t)
        qdot, vdot = (derivative(lambda s, i=i: problem.exact(s)[i], t, h) for i in (0, 1))
        inertia, applied = system.mass(t, q) @ vdot, np.asarray(problem.system.force(t, q, v))
        reaction = system.reaction(t, q, v, lam, mu)
        size = max(np.abs(x).max() for x in (inertia, applied, reaction))
        np.testing.assert_allclose(qdot, v, rtol=0, atol=1e-10 * np.abs(v).max())
        np.testing.assert_allclose(inertia, applied + reaction, rtol=0, atol=1e-9 * size)


@cases
def test_closed_solution_satisfies_the_constraints_on_both_levels(make, mechanics, name, parameters, h):
    problem = make(name, **parameters)
    system = mechanics(problem.system)
    for t in (0.0, *TIMES):
        q, v, _, _ = problem.exact(t)
        size = 1 + np.abs(q).max() + np.abs(v).max()
        for rows in (system.g(t, q), system.position_rate(t, q, v), system.k(t, q, v)):
            np.testing.assert_allclose(rows, 0.0, rtol=0, atol=1e-14 * size)


@cases
def test_closed_solution_begins_at_the_start(make, name, parameters, h):
    problem = make(name, **parameters)
    start = problem.exact(problem.t_span[0])
    np.testing.assert_allclose(start.q, problem.q0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(start.v, problem.v0, rtol=0, atol=1e-14)


CONSERVATIVE = [case[:2] for case in CASES if case[0] not in ("jay_negrut_test1", "jay_negrut_pendulum")]


@pytest.mark.parametrize(("name", "parameters"), [*CONSERVATIVE, ("jay_negrut_pendulum", {"c": 0.0})])
def test_energy_and_invariants_are_constant_on_the_closed_solution(make, name, parameters):
    problem = make(name, **parameters)
    declared = [f for f in ("energy", "invariants") if hasattr(problem.system, f)]
    assert "energy" in declared
    for f in declared:
        first, *later = (getattr(problem.system, f)(t, *problem.exact(t)[:2]) for t in (0.0, *TIMES))
        for values in later:
            jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12), values, first)


@pytest.mark.parametrize("name", [n for n in NAMES if n not in ("andrews", "oscillator_chain")])
def test_closed_solution_agrees_with_the_reference_values(make, name):
    """The digits come from extrapolation in 113-bit arithmetic (see ``source`` in the files)."""
    problem = make(name)
    reference = problem.reference
    assert reference["digits"] >= 13
    for i, t in enumerate(reference["t"]):
        for key, value in problem.exact(t)._asdict().items():
            np.testing.assert_allclose(value, reference[key][i], rtol=1e-13, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_start_is_consistent(make, mechanics, name):
    problem = make(name)
    system, start = mechanics(problem.system), (problem.t_span[0], problem.q0, problem.v0)
    for rows in (system.g(*start[:2]), system.position_rate(*start), system.k(*start)):
        np.testing.assert_allclose(rows, 0.0, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("jay_negrut_pendulum", {"c": 0.0}),
        ("andrews", {}),
        ("rolling_disk3d_steady", {"j0": 0.0}),
        ("oscillator_chain", {}),
    ],
)
def test_force_is_what_lagrange_derives_from_mass_and_energy(make, mechanics, name, parameters):
    """F = dT/dq - d(M v)/dq v - dV/dq with T = v M v / 2 and V the energy at rest, at a state off the constraints."""
    problem = make(name, **parameters)
    system, random = problem.system, np.random.default_rng(3)
    mass = getattr(system, "mass_matrix", None)
    momentum = (lambda q, v: mass(0.0, q) @ v) if callable(mass) else (lambda q, v: mass * v)
    q = problem.q0 + 0.1 * random.standard_normal(problem.q0.size)
    v = random.standard_normal(q.size)
    force = (
        jax.grad(lambda x: v @ momentum(x, v) / 2)(q)
        - jax.jvp(lambda x: momentum(x, v), (q,), (v,))[1]
        - jax.grad(lambda x: system.energy(0.0, x, 0 * v))(q)
    )
    np.testing.assert_allclose(system.force(0.0, q, v), force, rtol=1e-11, atol=1e-11 * np.abs(force).max())
    np.testing.assert_allclose(
        system.energy(0.0, q, v) - system.energy(0.0, q, 0 * v), v @ momentum(q, v) / 2, rtol=1e-11, atol=1e-11
    )


CHANGED = {
    "jay_negrut_pendulum": {"k": 100.0, "m": 4.0},
    "andrews": {"mom": 0.01, "c0": 100.0},
    "knife_edge": {"m": 2.0, "incline": 0.1},
    "rolling_disk3d_steady": {"m": 3.0, "theta": 0.4},
    "oscillator_chain": {"m": 2.0, "k": 7.0},
}


@pytest.mark.parametrize("name", CHANGED)
def test_new_parameter_values_do_not_trace_again(make, mechanics, name):
    traces = []

    @eqx.filter_jit
    def force(system, t, q, v):
        traces.append(1)
        mass = system.mass_matrix
        return system.force(t, q, v), mass(t, q) if callable(mass) else mass

    problem, changed = make(name), make(name, **CHANGED[name])
    values = [force(p.system, 0.0, problem.q0, problem.v0 + 1) for p in (problem, changed)]
    assert len(traces) == 1
    assert not np.array_equal(values[0][0], values[1][0])
    assert all(isinstance(leaf, jax.Array) and leaf.dtype == np.float64 for leaf in jax.tree.leaves(problem.system))


@pytest.mark.parametrize("name", CHANGED)
def test_reference_is_given_only_for_the_published_parameters_and_inside_the_interval(make, name):
    assert make(name, **CHANGED[name]).reference is None
    reference = make(name).reference
    if reference is None:
        assert name == "oscillator_chain"
        return
    assert reference["t"][-1] <= make(name).t_span[1]
    assert make(name, t_end=reference["t"][0] / 2).reference is None


@pytest.mark.parametrize("name", NAMES)
def test_sketch_gives_points_and_straight_pieces(make, name):
    problem = make(name)
    drawing = problem.sketch(problem.q0)
    points, lines = drawing["points"], drawing["lines"]
    assert points.ndim == 2
    assert lines.shape[1:] == (2, points.shape[1])
    assert np.isfinite(points).all()
    assert np.isfinite(lines).all()


@pytest.mark.parametrize("name", NAMES)
def test_problem_carries_its_name_source_and_tags(make, name):
    problem = make(name)
    assert problem.name == name
    assert problem.source
    assert problem.tags
