"""What is prepared for a system serves the next solves of it, and no other system or parameter."""

import gc

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from solvers.scipy_ivp import SciPySolver
from tests.lowering.changing import Sprung

SOLVERS = ("ida(form=ggl)", "ida(form=index1)", "cvode", "scipy(method=DOP853)", "projected", "collocation(stages=3)")


def swinging(system, solver):
    """Bits and counters of a solve from rest to the right."""
    start = {"t_span": (0.0, 0.1), "q0": [float(system.length), 0.0], "v0": [0.0, 0.0]}
    found = hb.solve(hb.Problem(name="x", system=system, **start), solver, rtol=1e-5)
    assert found.success, found.message
    return found.q.tobytes(), found.lam.tobytes(), found.counters


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_changed_parameter_of_a_prepared_system_is_a_new_preparation(solver):
    """Written to by its owner, swapped past the frozen class, and back again; another system of the class beside it."""
    system = Sprung()
    first = swinging(system, solver)
    assert first == swinging(system, solver) == swinging(Sprung(), solver)
    system.springs[0] = 30.0
    assert swinging(system, solver) == swinging(Sprung(springs=np.array([30.0, 5.0])), solver) != first
    system.springs[0] = 3.0
    system.mass_matrix[:] = 1.0
    assert swinging(system, solver) == swinging(Sprung(mass_matrix=np.ones(2)), solver) != first
    system.mass_matrix[1] = 2.0
    object.__setattr__(system, "length", jnp.asarray(2.0))
    assert swinging(system, solver) == swinging(Sprung(length=2.0), solver) != first
    object.__setattr__(system, "length", jnp.asarray(1.0))
    assert swinging(system, solver) == first


@pytest.mark.parametrize("solver", ["hht", *SOLVERS[:-1]])  # collocation interpolates otherwise where it has more rows
def test_the_multipliers_of_a_row_depend_on_no_other_row(solver):
    """Neither on how many there are, nor on what was solved before."""
    times = np.linspace(0.0, 0.1, 41)
    problem = hb.Problem(name="x", system=Sprung(), t_span=(0.0, 0.1), q0=[1.0, 0.0], v0=[0.0, 0.0])
    few, many, again = (hb.solve(problem, solver, rtol=1e-5, t_eval=t) for t in (times[::10], times, times[::10]))
    assert few.lam.tobytes() == again.lam.tobytes() == many.lam[::10].tobytes()


@pytest.mark.parametrize("solver", ["ida", "cvode"])
@pytest.mark.parametrize("limit", [{}, {"max_num_steps": 1}], ids=str)
def test_a_solve_leaves_nothing_to_the_garbage_collector(solver, limit):
    """Rows, library and callbacks are freed when the solve is over, however it ended."""
    problem = hb.Problem(name="x", system=Sprung(), t_span=(0.0, 0.1), q0=[1.0, 0.0], v0=[0.0, 0.0])
    for _ in range(2):
        hb.solve(problem, solver, rtol=1e-5, **limit)
    while gc.collect():  # what one look frees of earlier tests may have held more
        pass
    hb.solve(problem, solver, rtol=1e-5, **limit)
    assert gc.collect() == 0


def test_lsoda_has_its_jacobian_compiled_before_it_changes_to_stiff_steps(monkeypatch):
    """Else the second that this takes counts as the solve's, and a campaign calls it too slow."""
    made, jacobian = [], SciPySolver._jacobian
    monkeypatch.setattr(SciPySolver, "_jacobian", lambda *given: made.append(given) or jacobian(*given))
    hb.load_solver("scipy(method=LSODA)").warm_up(hb.load_problem("simple_pendulum"), hb.Request(rtol=1e-3))
    assert made
