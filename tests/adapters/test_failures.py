"""Budgets, statuses, values that are not finite, exceptions, and libraries that lie."""

import importlib
import sys
from dataclasses import replace
from time import sleep

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.errors import ProblemError
from hhtbench.lowering import compiling
from hhtbench.request import Request
from hhtbench.result import Status
from solvers import cvode, diffrax_ode, ida, scipy_ivp
from tests.adapters.scenes import HOST, Growing, Ring, numpy_ring, problem

TSIT5 = diffrax_ode.solver(method="Tsit5")
EVERY = pytest.mark.parametrize("solver", [*HOST, TSIT5], ids=lambda solver: solver.name)
ON_HOST = pytest.mark.parametrize("solver", HOST, ids=lambda solver: solver.name)
LOOSE = Request(rtol=1e-6)


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


@EVERY
def test_the_step_budget_counts_over_the_whole_span(solver):
    whole = solver.solve(problem(), LOOSE)
    solution = solver.solve(problem(), Request(rtol=1e-6, max_num_steps=2))
    assert solution.status is Status.max_steps
    assert solution.counters.steps_accepted == 2
    np.testing.assert_array_equal(solution.t, whole.t[:3])
    np.testing.assert_array_equal(solution.q, whole.q[:3])
    enough = whole.counters.steps_accepted
    assert solver.solve(problem(), Request(rtol=1e-6, max_num_steps=enough)).success


@ON_HOST
def test_the_budget_of_evaluations_stops_the_solve_and_keeps_the_steps(solver):
    calls = []
    scene = numpy_ring(force=lambda t, q, v: calls.append(t) or np.zeros(2))
    solution = solver.solve(scene, Request(rtol=1e-9, max_evaluations=45))
    assert solution.status is Status.evaluation_budget
    assert 1 <= solution.counters.steps_accepted == solution.t.size - 1
    rows = solution.t.size
    assert solution.counters.residual_evaluations <= 45 + rows
    assert len(calls) == solution.counters.residual_evaluations


def test_the_budget_of_evaluations_holds_in_compiled_code_to_a_segment():
    whole = TSIT5.count(problem(), Request(rtol=1e-10))
    budget = whole.residual_evaluations // 2
    solution = TSIT5.solve(problem(), Request(rtol=1e-10, max_evaluations=budget))
    assert solution.status is Status.evaluation_budget
    assert budget < solution.counters.residual_evaluations < whole.residual_evaluations
    assert solution.t[-1] < 1.0


@ON_HOST
def test_the_time_budget_stops_the_solve(solver):
    scene = numpy_ring(force=lambda t, q, v: sleep(0.01) or np.zeros(2))
    solution = solver.solve(scene, Request(rtol=1e-9, max_seconds=0.15))
    assert solution.status is Status.deadline


def test_the_time_budget_stops_a_compiled_solve_between_segments():
    TSIT5.warm_up(problem(), LOOSE)
    long = problem(t_span=(0.0, 1e7))
    solution = TSIT5.solve(long, Request(rtol=1e-9, max_seconds=0.3, t_eval=[1e7]))
    assert solution.status is Status.deadline


# --- values that are not finite ---------------------------------------------------------------------------------------


def until(limit):
    return lambda t, q, v: np.array([0.0, 0.0 if t < limit else np.nan])


@ON_HOST
def test_a_force_that_ends_is_named_with_its_component(solver):
    solution = solver.solve(numpy_ring(force=until(0.5)), LOOSE)
    assert solution.status is Status.nonfinite_callback
    assert "force[1] = nan" in solution.message
    assert 0.2 < solution.t[-1] < 0.5
    assert np.isfinite(solution.q).all()
    assert solution.counters.nonfinite_evaluations > 0


class Ending(Ring):
    """In compiled code NaN raises nothing: the function is found afterwards."""

    def force(self, t, q, v):
        return jnp.where(t < 0.5, 0.0, jnp.nan) * jnp.ones(2)


@pytest.mark.parametrize("solver", [ida.solver(), scipy_ivp.solver(method="DOP853"), TSIT5], ids=lambda solver: solver.name)
def test_the_function_is_named_in_compiled_code_too(solver):
    solution = solver.solve(problem(system=Ending()), LOOSE)
    assert solution.status is Status.nonfinite_callback
    assert "force[0] = nan" in solution.message
    assert 0.2 < solution.t[-1] <= 0.5


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


def test_an_inconsistent_start_is_told_with_its_rows():
    solution = ida.solver().solve(replace(problem(), q0=np.array([1.1, 0.0])), LOOSE)
    assert solution.status is Status.inconsistent_initial
    assert "g[0]" in solution.message


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


def test_nothing_of_a_library_is_printed(capfd):
    for solver in HOST:
        solver.solve(numpy_ring(force=until(0.5)), LOOSE)
    failed = ida.solver(form="index3").solve(problem("nonlinear reaction"), Request(rtol=1e-8, max_seconds=20.0))
    assert failed.status in (Status.newton_failed, Status.step_too_small)
    assert "Error: " in failed.message, "what IDA prints goes into the message"
    assert capfd.readouterr() == ("", "")


def test_what_a_callback_prints_is_passed_on(capfd):
    calls = []

    def force(t, q, v):
        calls.append(t)
        sys.stdout.write("here\n")
        return np.zeros(2)

    ida.solver().solve(numpy_ring(force=force), LOOSE)
    assert capfd.readouterr().out == "here\n" * len(calls)


def test_a_buffer_that_the_system_reuses_does_no_harm():
    buffer = np.zeros(2)

    def force(t, q, v):
        buffer[:] = -q
        return buffer

    for solver in HOST:
        assert solver.solve(numpy_ring(force=force), LOOSE).success


# --- libraries that lie -----------------------------------------------------------------------------------------------


def lying(real, tamper):
    """The library's class with ``tamper`` applied to what step number 5 and later return."""

    class Liar:
        def __init__(self, *arguments, **options):
            self.real, self.count = real(*arguments, **options), 0

        def init_step(self, *arguments):
            return self.real.init_step(*arguments)

        def step(self, *arguments, **options):
            self.count += 1
            result = self.real.step(*arguments, **options)
            if self.count >= 5:
                tamper(result)
            return result

    return Liar


def set_to(**values):
    def tamper(result):
        for name, value in values.items():
            setattr(result, name, value(result))

    return tamper


LIES = {
    "not finite": set_to(y=lambda r: np.full_like(r.y, np.nan)),
    "time goes back": set_to(t=lambda r: -1.0),
    "past the end": set_to(t=lambda r: 2.0),
    "off the circle": set_to(y=lambda r: 1.2 * r.y),
    "too short": set_to(y=lambda r: r.y[:-1]),
}


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize(("module", "name"), [(ida, "IDA"), (cvode, "CVODE")], ids=["ida", "cvode"])
def test_a_success_that_is_none_is_unreliable(module, name, lie, monkeypatch):
    monkeypatch.setattr(module, name, lying(getattr(module, name), LIES[lie]))
    solution = module.solver().solve(problem(), LOOSE)
    assert solution.status is Status.unreliable, solution.message
    assert np.isfinite(solution.q).all()
    if lie != "off the circle":
        assert solution.counters.steps_accepted == 4, "the bad step was taken"


@pytest.mark.parametrize("module", [ida, cvode], ids=["ida", "cvode"])
def test_time_that_stands_still_ends_the_solve(module, monkeypatch):
    name, seen = "IDA" if module is ida else "CVODE", []

    def stop(result):
        seen.append(result.t)
        result.t = seen[0]

    monkeypatch.setattr(module, name, lying(getattr(module, name), stop))
    solution = module.solver().solve(problem(), LOOSE)
    assert solution.status is Status.time_resolution
    assert solution.counters.steps_accepted == 5


def test_an_end_that_was_not_reached_is_unreliable(monkeypatch):
    class Early(scipy_ivp.integrate.DOP853):
        def step(self):
            message = super().step()
            self.status = "finished"
            return message

    monkeypatch.setattr(scipy_ivp.integrate, "DOP853", Early)
    solution = scipy_ivp.solver(method="DOP853").solve(problem(), LOOSE)
    assert solution.status is Status.unreliable
    assert 0 < solution.t.size < 5

    monkeypatch.setattr(type(ida.solver()), "drive", lambda self, run: None)
    solution = ida.solver().solve(problem(), LOOSE)
    assert solution.status is Status.unreliable
    assert "stopped at t = 0" in solution.message


def test_rows_that_are_missing_are_unreliable(monkeypatch):
    real = type(ida.solver()).drive

    def short(self, run):
        real(self, run)
        run._times.pop()
        run._rows.pop()

    monkeypatch.setattr(type(ida.solver()), "drive", short)
    solution = ida.solver().solve(problem(), Request(rtol=1e-6, t_eval=[0.0, 0.5, 1.0]))
    assert solution.status is Status.unreliable
    assert "2 of 3 rows" in solution.message


def test_a_library_that_raises_costs_its_own_solve_only(monkeypatch):
    class Broken:
        def __init__(self, *_, **__):
            raise RuntimeError("made")

    monkeypatch.setattr(ida, "IDA", Broken)
    solution = ida.solver().solve(problem(), LOOSE)
    assert solution.status is Status.unreliable
    assert "RuntimeError" in solution.message


def raising_at(call, raised, calls):
    def force(t, q, v):
        calls.append(t)
        if len(calls) == call:
            raise raised
        return np.zeros(2)

    return numpy_ring(force=force)


def test_a_library_that_swallows_an_exception_and_tries_again_does_not_hide_it(monkeypatch):
    raised, calls, steps = ArithmeticError("made"), [], []

    class Swallower(lying(ida.IDA, lambda result: None)):
        def step(self, *arguments, **options):
            steps.append(len(calls))
            for _ in range(3):
                try:
                    self.last = super().step(*arguments, **options)
                    return self.last
                except ArithmeticError:
                    self.last.t += 1e-4
            return self.last

    monkeypatch.setattr(ida, "IDA", Swallower)
    with pytest.raises(ArithmeticError) as caught:
        ida.solver().solve(raising_at(50, raised, calls), LOOSE)
    assert caught.value is raised
    assert len(calls) == 50, "a function was called again after it raised"
    assert steps[-1] < 50, "the library was stepped again"


def test_a_library_that_wraps_an_exception_does_not_hide_it(monkeypatch):
    raised, calls = ArithmeticError("made"), []

    class Wrapper(lying(ida.IDA, lambda result: None)):
        def step(self, *arguments, **options):
            try:
                return super().step(*arguments, **options)
            except ArithmeticError as error:
                raise RuntimeError("the residual function failed") from error

    monkeypatch.setattr(ida, "IDA", Wrapper)
    with pytest.raises(ArithmeticError) as caught:
        ida.solver().solve(raising_at(50, raised, calls), LOOSE)
    assert caught.value is raised


@pytest.mark.parametrize("module", [ida, cvode], ids=["ida", "cvode"])
@pytest.mark.parametrize(
    ("flag", "status"), [(-3, Status.step_too_small), (-4, Status.newton_failed), (-99, Status.unreliable)]
)
def test_flags_of_sundials_have_our_names(module, flag, status, monkeypatch):
    name = "IDA" if module is ida else "CVODE"
    monkeypatch.setattr(module, name, lying(getattr(module, name), set_to(status=lambda r: flag)))
    solution = module.solver().solve(problem(), LOOSE)
    assert solution.status is status
    assert solution.counters.steps_accepted == 4 == solution.t.size - 1


# --- counters ---------------------------------------------------------------------------------------------------------


@ON_HOST
def test_evaluations_are_counted_where_they_happen(solver):
    """On plain callables every call of the force is one evaluation; compiled code says how many points it takes."""
    calls = []
    scene = numpy_ring(force=lambda t, q, v: calls.append(t) or np.zeros(2))
    counters = solver.solve(scene, LOOSE).counters
    assert counters.residual_evaluations == len(calls) > 0
    compiled = solver.solve(problem(), LOOSE).counters
    assert compiled.steps_accepted == pytest.approx(counters.steps_accepted, rel=0.4)
    assert compiled.residual_evaluations > compiled.steps_accepted
    assert compiled.newton_iterations is None, "what nobody reports is not zero"
    assert "not reported" in compiled.provenance


def test_evaluations_of_ida_are_those_of_the_library(monkeypatch):
    seen = []
    monkeypatch.setattr(ida, "IDA", lying(ida.IDA, lambda result: seen.append((result.nfev, result.njev))))
    counters = ida.solver().solve(problem(), Request(rtol=1e-6, t_eval=[1.0])).counters
    assert counters.residual_evaluations == seen[-1][0] + 2  # the start's acceleration level, and the row's
    assert counters.jacobian_evaluations == seen[-1][1]
    assert "1 for multipliers at output rows" in counters.provenance


def test_compiled_evaluations_come_from_a_second_run():
    asked = Request(rtol=1e-8, t_eval=[1.0])
    first = TSIT5.solve(problem(), asked)
    second = TSIT5.count(problem(), asked)
    assert first.counters.residual_evaluations is None
    assert "second run" in second.provenance
    assert second.steps_accepted == first.counters.steps_accepted
    attempts = second.steps_accepted + second.steps_rejected_error
    assert 6 * attempts <= second.residual_evaluations <= 6 * attempts + 8  # Tsit5: six stages a step, FSAL


def test_compiled_code_is_shared_between_tolerances_and_parameters():
    def run(**request):
        TSIT5.solve(problem("rheonomic", system=Growing(growth=0.3)), Request(**request))

    run(rtol=1e-5)
    before = sum(entry._cache_size() for entry in compiling._compiled.values())
    run(rtol=1e-7)
    run(rtol=1e-6, atol=1e-9, max_num_steps=3)
    run(rtol=1e-6, max_seconds=5.0)
    assert sum(entry._cache_size() for entry in compiling._compiled.values()) == before


@EVERY
def test_nothing_compiles_after_the_warm_up(solver):
    asked = Request(rtol=1e-6, t_eval=np.linspace(0, 1, 5))
    solver.warm_up(problem(), asked)
    before = sum(entry._cache_size() for entry in compiling._compiled.values())
    assert solver.solve(problem(), asked).success
    assert sum(entry._cache_size() for entry in compiling._compiled.values()) == before
