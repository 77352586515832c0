"""What a solver prepares for a system serves its next solves, and no other system or parameter."""

import warnings
from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.lowering.caching import Cache
from hhtbench.protocol.errors import BudgetSpent
from hhtbench.solution.result import Status
from solvers.hht import HHT
from solvers.hht.run import functions
from solvers.kernel import full, kkt
from tests.lowering.changing import Declared, Massless, Redundant, Sprung

ONE_ROW_LESS = pytest.mark.filterwarnings("ignore:redundant constraints")


def swinging(solve, length=1.0):
    """Bits and counters of a solve from rest at ``length`` to the right."""
    found = solve([length, 0.0])
    assert found.success, found.message
    return found.q.tobytes(), found.lam.tobytes(), found.counters


@pytest.mark.parametrize(
    ("kind", "how"),
    [
        *((kind, {"step": 0.01}) for kind in (Declared, Massless)),
        (Sprung, {"rtol": 1e-4}),
        pytest.param(Redundant, {"rtol": 1e-4}, marks=ONE_ROW_LESS),
    ],
    ids=str,
)
def test_a_changed_parameter_of_a_prepared_system_is_a_new_preparation(how, kind):
    """Written to by its owner, swapped past the frozen class, and back again."""

    def solves(system):
        solver = HHT(system)
        problem = lambda q0: hb.Problem(name="x", system=system, t_span=(0.0, 0.2), q0=q0, v0=[0.0, 0.0])  # noqa: E731
        atol = {} if "step" in how else {"atol": 1e-6}
        return lambda q0: solver.solve((0.0, 0.2), q0, [0.0, 0.0], **how, **atol), lambda q0: hb.solve(
            problem(q0), "hht", **how, **atol
        )

    def fresh(**parameters):
        return swinging(solves(kind(**parameters))[0], parameters.get("length", 1.0))

    system = kind()
    for solve in solves(system):
        first = swinging(solve)
        assert first == swinging(solve) == fresh()
        system.springs[0] = 30.0
        assert swinging(solve) == fresh(springs=np.array([30.0, 5.0])) != first
        system.springs[0] = 3.0
        assert swinging(solve) == first
        before = system.mass_matrix.copy()
        system.mass_matrix[:] = 1.0
        assert swinging(solve) == fresh(mass_matrix=np.ones(2)) != first
        system.mass_matrix[:] = before
        object.__setattr__(system, "length", jnp.asarray(2.0))
        assert swinging(solve, 2.0) == fresh(length=2.0)
        object.__setattr__(system, "length", jnp.asarray(1.0))
        assert swinging(solve) == first


def test_what_is_prepared_serves_nested_solves_and_threads_too():
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


class Linkage(hb.System):
    """Two points on rods of ``lengths`` about two pivots, the second ``apart`` from the first; masses vary with q."""

    apart: object = hb.parameter(2.0)
    uneven: object = hb.parameter(0.0)

    def force(self, t, q, v):
        return jnp.array([0.0, -9.81, 0.0, -9.81]) / (q[0] + 1.0)

    def mass_matrix(self, t, q):
        return jnp.diag(jnp.array([1.0, 1.0, q[2] - 1.5, 2.0])).at[0, 1].set(self.uneven)

    def constraint(self, t, q):
        return jnp.stack([(q[:2] @ q[:2] - 1.0) / 2, ((q[2] - self.apart) ** 2 + q[3] ** 2 - 1.0) / 2])


GOOD = [1.0, 0.0, 3.0, 0.0], [0.0, 1.0, 0.0, -1.0]
STARTS = {  # with a part of what is said of them
    "off the position level": ([1.0 + 1e-6, 0.0, 3.0, 0.0], GOOD[1], {}, "the start violates g[0] = 1e-06"),
    "off the velocity level": (GOOD[0], [1e-6, 1.0, 0.0, -1.0], {}, "the start violates (g_t + g_q v)[0] = 1e-06"),
    "within the bound of both": ([1.0 + 4e-9, 0.0, 3.0, 0.0], [2e-9, 1.0, 0.0, -1.0], {}, "The end of the interval"),
    "no mass there": ([1.0, 0.0, 1.5, np.sqrt(0.75)], [0.0, 1.0, 0.0, 0.0], {}, "The mass matrix is singular at the start"),
    "a force that is not a number": ([-1.0, 0.0, 3.0, 0.0], GOOD[1], {}, "force[0] = nan at t = 0"),
    "a guess of the wrong size": (*GOOD, {"lam_guess": [1.0]}, "lam_guess must have shape (2,)"),
    "too few evaluations": (*GOOD, {"max_evaluations": 1}, "max_evaluations"),
}


def outcome(system, q0, v0, **request):
    """How a solve ends and what it says; or what it raises."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            found = HHT(system).solve((0.0, 0.01), q0, v0, steps=2, **request)
        except hb.ProblemError as error:
            return str(error)
    return found.status, found.message, found.counters, found.q.tobytes(), [str(warning.message) for warning in said]


@pytest.mark.parametrize("name", STARTS)
def test_a_prepared_system_says_of_a_start_what_a_new_one_says(name):
    q0, v0, request, said = STARTS[name]
    prepared = Linkage()
    assert outcome(prepared, *GOOD)[0] is Status.success
    found = outcome(prepared, q0, v0, **request)
    assert said in (found if isinstance(found, str) else found[1])
    assert found == outcome(Linkage(), q0, v0, **request)


def test_a_derivative_that_turns_wrong_in_a_prepared_system_is_told_of_and_not_used():
    """At every solve anew, and no longer when it is right again."""
    system = Declared()
    right = outcome(system, [1.0, 0.0], [0.0, 0.0])
    assert right == outcome(system, [1.0, 0.0], [0.0, 0.0])
    assert right[-1] == []
    system.slanted[0] = 0.1
    for _ in range(2):
        wrong = outcome(system, [1.0, 0.0], [0.0, 0.0])
        assert "the declared constraint_jacobian disagrees" in wrong[-1][0]
        np.testing.assert_allclose(np.frombuffer(wrong[3]), np.frombuffer(right[3]), rtol=1e-12, atol=1e-15)
    system.slanted[0] = 0.0
    assert outcome(system, [1.0, 0.0], [0.0, 0.0]) == right


@pytest.mark.parametrize("last", range(1, 6))
def test_a_time_budget_that_ends_while_code_is_made_leaves_no_half_of_it(last, monkeypatch):
    """Of force, constraint levels and KKT system for the start; of error and levels for step control."""
    make, calls = functions.native, []
    watched = {"force_and_inverse_mass", "level_terms", "kkt_terms", "raw_errors", "levels"}

    def native(function, *given, **options):
        if function.__name__ in watched:
            calls.append(function)
            if len(calls) == last:
                raise BudgetSpent("seconds", 1.0)
        return make(function, *given, **options)

    for module in (functions, full, kkt):
        monkeypatch.setattr(module, "native", native)
    monkeypatch.setattr(functions, "_known", Cache(16))
    system = Sprung()
    ended, again = (HHT(system).solve((0.0, 0.2), [1.0, 0.0], [0.0, 0.0], rtol=1e-4) for _ in range(2))
    assert ended.status is Status.deadline
    assert again.success, again.message


START = (0.0, 0.2), [1.0, 0.0], [0.0, 0.0]
HOW = ({"step": 0.01}, {"rtol": 1e-4})


class Pendulum:
    """A rod, whose functions look at what may change; a second row that binds the angle can be asked for."""

    def __init__(self, gravity=9.81, rows=1, mass=(1.0, 1.0)):
        self.gravity, self.rows = gravity, rows
        self.system = hb.NumpySystem(force=self.force, constraint=self.constraint, mass_matrix=np.array(mass))

    def force(self, t, q, v):
        return np.array([0.0, -self.gravity])

    def constraint(self, t, q):
        return np.array([q @ q - 1.0, q[1]][: self.rows])


def solved(system, how):
    """Bits and counters."""
    found = HHT(system).solve(*START, **how)
    assert found.success, found.message
    return found.q.tobytes(), found.lam.tobytes(), found.counters


@pytest.mark.parametrize("how", HOW, ids=str)
def test_what_the_functions_refer_to_may_change_between_two_solves(how):
    changing = Pendulum()
    first = solved(changing.system, how)
    changing.gravity = 3.0
    assert solved(changing.system, how) == solved(Pendulum(gravity=3.0).system, how) != first
    changing.gravity = 9.81
    assert solved(changing.system, how) == first


def test_another_number_of_constraints_or_another_mass_is_a_new_preparation():
    changing, how = Pendulum(), {"step": 0.01}
    first = solved(changing.system, how)
    changing.rows = 2
    assert solved(changing.system, how) == solved(Pendulum(rows=2).system, how) != first
    changing.rows = 1
    object.__setattr__(changing.system, "mass_matrix", np.array([1.0, 3.0]))
    assert solved(changing.system, how) == solved(Pendulum(mass=(1.0, 3.0)).system, how)
