"""Budgets, statuses, values that are not finite, exceptions, and libraries that lie."""

import importlib
import sys

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol.errors import ProblemError
from hhtbench.solution.request import Request
from hhtbench.solution.result import Status
from solvers import cvode, diffrax_ode, ida, projected, scipy_ivp
from solvers._diffrax_loop import SEGMENT
from tests.adapters.scenes import EVERY, HOST, LOOSE, ON_HOST, TSIT5, Ring, numpy_ring, problem

# --- wrong use --------------------------------------------------------------------------------------------------------


def test_unknown_options_and_values_are_told_with_what_is_known():
    with pytest.raises(TypeError, match=r"ida does not know frm; known: form"):
        ida.solver(frm="ggl")
    with pytest.raises(ProblemError, match=r"no form 'gg1'.*Did you mean ggl"):
        ida.solver(form="gg1")
    with pytest.raises(ProblemError, match=r"Did you mean Radau"):
        scipy_ivp.solver(method="radau")
    with pytest.raises(ProblemError, match=r"Did you mean adams"):
        cvode.solver(method="adam")
    with pytest.raises(ProblemError, match=r"Did you mean Kvaerno5"):
        diffrax_ode.solver(method="Kvaerno4")


@EVERY
def test_requests_it_cannot_take_are_declined_before_any_call(solver):
    def never(*_):
        raise AssertionError("called")

    scene = numpy_ring(**dict.fromkeys(("force", "constraint", "constraint_jacobian"), never))
    for request, reason in (
        (Request(step=0.1), "chooses its own steps"),
        (Request(), "give rtol"),
        (Request(atol=1e-6), "give rtol"),
        (Request(rtol=0.0), "give atol"),
        (Request(rtol=1e-6, options={"alpha": 0}), "unknown option alpha"),
    ):
        if solver.library == "diffrax":
            reason = "cannot be compiled"
        assert reason in solver.accepts(scene, request)
        solution = solver.solve(scene, request)
        assert solution.status is Status.declined
        assert reason in solution.message
        assert solution.t.size == 0


def test_a_tolerance_of_the_wrong_length_is_refused():
    with pytest.raises(ProblemError, match=r"\(2,\) or \(4,\).*got shape \(3,\)"):
        ida.solver().solve(problem(), Request(rtol=1e-6, atol=np.ones(3)))


@pytest.mark.parametrize(
    ("module", "blocked", "library"),
    [
        (ida, "sksundae.ida", "scikit-sundae"),
        (cvode, "sksundae.cvode", "scikit-sundae"),
        (diffrax_ode, "diffrax", "diffrax"),
    ],
    ids=["ida", "cvode", "diffrax"],
)
def test_a_missing_library_is_a_reason_and_not_an_import_error(module, blocked, library, monkeypatch):
    with monkeypatch.context() as without:
        without.setitem(sys.modules, blocked, None)
        without.delitem(sys.modules, "solvers._diffrax_loop", raising=False)
        if "_diffrax_loop" in vars(sys.modules["solvers"]):
            without.delattr("solvers._diffrax_loop")
        importlib.reload(module)
        solver = module.solver()
        assert solver.accepts(problem(), LOOSE) == f"skipped, {library} is not installed"
        assert solver.solve(problem(), LOOSE).status is Status.declined
    importlib.reload(module)
    assert module.solver().accepts(problem(), LOOSE) is None


# --- budgets ----------------------------------------------------------------------------------------------------------


def test_the_budget_of_evaluations_holds_in_compiled_code_to_a_segment():
    scene = problem(t_span=(0.0, 10.0))  # about 5 segments
    whole = TSIT5.count(scene, Request(rtol=1e-10))
    budget = whole.residual_evaluations // 2
    solution = TSIT5.solve(scene, Request(rtol=1e-10, max_evaluations=budget))
    assert solution.status is Status.evaluation_budget
    assert budget < solution.counters.residual_evaluations < whole.residual_evaluations
    assert solution.counters.residual_evaluations <= budget + 6 * SEGMENT
    assert 1.0 < solution.t[-1] < 10.0


def test_the_time_budget_stops_a_compiled_solve_between_segments():
    TSIT5.warm_up(problem(), LOOSE)
    long = problem(t_span=(0.0, 1e7))
    solution = TSIT5.solve(long, Request(rtol=1e-9, max_seconds=0.3, t_eval=[1e7]))
    assert solution.status is Status.deadline


# --- values that are not finite ---------------------------------------------------------------------------------------


class Ending(Ring):
    """In compiled code NaN raises nothing: the function is found afterwards."""

    def force(self, t, q, v):
        return jnp.where(t < 0.5, 0.0, jnp.nan) * jnp.ones(2)


@pytest.mark.parametrize(
    "solver",
    [ida.solver(), scipy_ivp.solver(method="DOP853"), projected.solver(), TSIT5],
    ids=lambda solver: solver.name,
)
def test_the_function_is_named_in_compiled_code_too(solver):
    solution = solver.solve(problem(system=Ending()), LOOSE)
    assert solution.status is Status.nonfinite_callback
    assert "force[0] = nan" in solution.message
    assert 0.2 < solution.t[-1] <= 0.5
    assert np.isfinite(solution.q).all()


@ON_HOST
def test_a_jacobian_that_is_not_finite_does_not_hang(solver):
    scene = numpy_ring(force_jacobians=lambda t, q, v: (np.full((2, 2), np.nan), np.zeros((2, 2))))
    solution = solver.solve(scene, Request(rtol=1e-6, max_seconds=20.0))
    assert solution.success or (solution.status is Status.nonfinite_callback and "force_jacobians" in solution.message), (
        solution.message
    )


@ON_HOST
@pytest.mark.parametrize("which", [20, 50])
def test_one_stray_value_costs_no_run(solver, which):
    """All but LSODA shrink the step; LSODA accepts it, which is found by looking at the state."""
    calls = []

    def force(t, q, v):
        calls.append(t)
        return np.full(2, np.nan if len(calls) == which else 0.0)

    solution = solver.solve(numpy_ring(force=force), LOOSE)
    if solver.method == "LSODA" and not solution.success:
        assert solution.status is Status.nonfinite_callback
        return
    assert solution.success, solution.message
    assert solution.counters.nonfinite_evaluations == int(len(calls) >= which)
    assert np.abs(solution.q[-1] - scene_end()).max() < 1e-4


def scene_end():
    return problem().exact(1.0).q


@pytest.mark.parametrize("solver", [*HOST, hb.load_solver("hht")], ids=lambda solver: solver.name)
def test_of_a_success_that_has_lost_its_rows_the_message_says_the_loss_alone(solver):
    """The force is not finite once the steps are made: no row has multipliers."""
    calls, steps = [], np.inf

    def force(t, q, v):
        calls.append(t)
        return np.full(2, np.nan if len(calls) > steps else 0.0)

    whole = solver.solve(numpy_ring(force=force), LOOSE)
    assert whole.success, whole.message
    steps = len(calls) - whole.t.size  # every row takes one more for its multipliers
    calls.clear()
    lost = solver.solve(numpy_ring(force=force), LOOSE)
    assert (lost.status, lost.t.size) == (Status.nonfinite_callback, 0)
    assert lost.message.startswith("force")
    assert lost.message.endswith("when the multipliers were recovered.")


# --- exceptions -------------------------------------------------------------------------------------------------------


@ON_HOST
@pytest.mark.parametrize("kind", [ZeroDivisionError, KeyboardInterrupt, ProblemError])
def test_an_exception_comes_back_as_the_same_object_with_the_steps_so_far(solver, kind):
    raised, calls = kind("made"), []

    def force(t, q, v):
        calls.append(t)
        if len(calls) >= 50:
            raise raised
        return np.zeros(2)

    with pytest.raises(kind) as caught:
        solver.solve(numpy_ring(force=force), Request(rtol=1e-9))
    assert caught.value is raised
    assert len(calls) == 50, "a function was called again after it raised"
    partial = raised.partial_solution
    assert partial.status is (Status.interrupted if kind is KeyboardInterrupt else Status.user_exception)
    assert partial.t.size >= 2
    assert partial.q.shape == (partial.t.size, 2)
    assert partial.lam.shape == (partial.t.size, 1)


def test_an_exception_in_the_jacobian_comes_back_through_c():
    calls, raised = [], LookupError("made")

    def jacobians(t, q, v):
        calls.append(t)
        if len(calls) == 1:
            raise raised
        return np.zeros((2, 2)), np.zeros((2, 2))

    for solver in (ida.solver(), cvode.solver()):
        calls.clear()
        with pytest.raises(LookupError) as caught:
            solver.solve(numpy_ring(force_jacobians=jacobians), Request(rtol=1e-6))
        assert caught.value is raised


def test_a_run_that_ends_before_its_first_output_has_no_rows_and_says_why():
    problem = hb.load_problem("knife_edge")
    solution = hb.solve(problem, "ida(form=integrated)", rtol=1e-3, t_eval=[problem.t_span[1]], max_num_steps=1)
    assert solution.status is Status.max_steps
    assert solution.t.size == 0


@pytest.mark.parametrize("solver", [ida.solver(), cvode.solver()], ids=lambda solver: solver.name)
def test_tolerances_below_roundoff_are_named_with_larger_ones(solver):
    solution = solver.solve(problem(), Request(rtol=0.0, atol=1e-18))
    assert solution.status is Status.step_too_small
    assert "Roundoff is reached: loosen the tolerances" in solution.message
    assert "jump" not in solution.message
