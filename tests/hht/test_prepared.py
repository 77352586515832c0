"""What a solver prepares for a system serves its next solves, and no other system or parameter."""

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.result import Status
from solvers.hht import HHT


class Sprung(hb.System):
    """A pendulum on a spring; its spring is an array that its owner may write to."""

    length: object = hb.parameter(1.0)
    springs: object = dataclasses.field(default_factory=lambda: np.array([3.0, 5.0]))
    mass_matrix: object = dataclasses.field(default_factory=lambda: np.array([1.0, 2.0]))

    def force(self, t, q, v):
        return jnp.array([0.0, -9.81]) - self.springs * q

    def constraint(self, t, q):
        return jnp.stack([(q @ q - self.length**2) / 2])


def swinging(solve, length=1.0):
    """Bits and counters of a solve from rest at ``length`` to the right."""
    found = solve([length, 0.0])
    assert found.success, found.message
    return found.q.tobytes(), found.lam.tobytes(), found.counters


@pytest.mark.parametrize("how", [{"step": 0.01}, {"rtol": 1e-4}], ids=str)
def test_a_changed_parameter_of_a_prepared_system_is_a_new_preparation(how):
    """Written to by its owner, swapped past the frozen class, and back again."""

    def solves(system):
        solver = HHT(system)
        problem = lambda q0: hb.Problem(name="x", system=system, t_span=(0.0, 0.2), q0=q0, v0=[0.0, 0.0])  # noqa: E731
        atol = {} if "step" in how else {"atol": 1e-6}
        return lambda q0: solver.solve((0.0, 0.2), q0, [0.0, 0.0], **how, **atol), lambda q0: hb.solve(
            problem(q0), "hht", **how, **atol
        )

    def fresh(**parameters):
        return swinging(solves(Sprung(**parameters))[0], parameters.get("length", 1.0))

    system = Sprung()
    for solve in solves(system):
        first = swinging(solve)
        assert first == swinging(solve) == fresh()
        system.springs[0] = 30.0
        assert swinging(solve) == fresh(springs=np.array([30.0, 5.0])) != first
        system.springs[0] = 3.0
        assert swinging(solve) == first
        system.mass_matrix[:] = 1.0
        assert swinging(solve) == fresh(mass_matrix=np.ones(2)) != first
        system.mass_matrix[1] = 2.0
        object.__setattr__(system, "length", jnp.asarray(2.0))
        assert swinging(solve, 2.0) == fresh(length=2.0)
        object.__setattr__(system, "length", jnp.asarray(1.0))
        assert swinging(solve) == first


@pytest.mark.parametrize("how", [{"step": 0.01}, {"rtol": 1e-4}], ids=str)
def test_two_systems_of_one_class_and_one_solver_twice_do_not_mix(how):
    """A failure, an exception and other requests between two equal solves leave nothing behind."""
    solver, other = HHT(Sprung(), events=lambda t, q, v: q[1] + 0.1), HHT(Sprung(springs=np.array([1.0, 1.0])))
    solve = lambda q0: solver.solve((0.0, 0.2), q0, [0.0, 0.0], **how)  # noqa: E731
    first = swinging(solve)
    assert first != swinging(lambda q0: other.solve((0.0, 0.2), q0, [0.0, 0.0], **how))
    assert not solver.solve((0.0, 0.2), [3.0, 0.0], [0.0, 0.0], **how).success
    assert solver.solve((0.0, 9.0), [1.0, 0.0], [0.0, 0.0], **how, max_evaluations=50).status is Status.evaluation_budget
    assert solver.init_step(0.0, [0.0, 1.0], [0.5, 0.0], **how) is Status.success
    stepped = [solver.step() for _ in range(3)], solver.state.q.tobytes()
    assert swinging(solve) == first
    assert solver.state.q.tobytes() == stepped[1]
    solver.solve((0.5, 0.1), [0.0, -1.0], [1.0, 0.0], steps=7)
    assert swinging(solve) == first


def test_the_adapter_checks_options_that_compare_equal_to_those_of_a_kept_solver():
    problem = hb.Problem(name="x", system=Sprung(), t_span=(0.0, 0.1), q0=[1.0, 0.0], v0=[0.0, 0.0])
    assert hb.load_solver("hht").solve(problem, hb.Request(steps=5, options={"rescale_a": True})).success
    with pytest.raises(TypeError, match="rescale_a must be True or False; got 1"):
        hb.load_solver("hht").solve(problem, hb.Request(steps=5, options={"rescale_a": 1}))


def test_a_kept_solver_serves_nested_solves_and_threads_too():
    """While it is in use another one is made; all give the bits of one alone."""
    system = Sprung()
    problem = hb.Problem(name="x", system=system, t_span=(0.0, 0.2), q0=[1.0, 0.0], v0=[0.0, 0.0])

    def alone(_=0):
        return hb.solve(problem, "hht", steps=50).q.tobytes()

    wanted, inner = alone(), []
    outer = hb.NumpySystem(force=lambda t, q, v: inner.append(alone()) or -q)
    assert HHT(outer).solve((0.0, 0.1), [1.0], [0.0], steps=2).success
    with ThreadPoolExecutor(4) as pool:
        assert set(pool.map(alone, range(40))) == set(inner) == {wanted}


def test_a_parameter_is_an_array_of_the_systems_own_wherever_the_given_one_lies():
    """NumPy's memory that lies at a multiple of 64 bytes could be shared, and change with its owner."""
    room = np.zeros(32)
    at = next(i for i in range(8) if room[i:].ctypes.data % 64 == 0)
    given = room[at : at + 1]
    system = Sprung(length=given)
    given[0] = 3.0
    assert system.length == 0.0


def test_an_event_that_reads_a_parameter_sees_the_value_of_each_solve():
    system = Sprung()
    solver = HHT(system, events=lambda t, q, v: q[0] * system.springs[1] - 2.0)

    def located():
        (times,) = solver.solve((0.0, 1.0), [1.0, 0.0], [0.0, 0.0], rtol=1e-6).t_events
        return times

    first = located()
    system.springs[1] = 4.0
    again = located()
    own = solver.solve((0.0, float(again[0])), [1.0, 0.0], [0.0, 0.0], rtol=1e-6)
    assert again[0] != first[0]
    assert own.q[-1, 0] * 4.0 == pytest.approx(2.0, abs=1e-3)
