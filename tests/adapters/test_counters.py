"""Work is counted where it happens, also inside compiled code."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from hhtbench.solution.request import Request
from hhtbench.solution.result import Status
from solvers import diffrax_ode, ida, scipy_ivp
from tests.adapters.liar import lying
from tests.adapters.scenes import EVERY, LOOSE, ON_HOST, TSIT5, Growing, numpy_ring, problem
from tests.lowering.native import compiled_pieces


@ON_HOST
def test_evaluations_are_counted_where_they_happen(solver):
    """On plain callables every call of the force or for a difference is one; compiled code says how many points it takes."""
    calls, others = [], []
    plain = numpy_ring().system
    scene = numpy_ring(
        force=lambda t, q, v: calls.append(t) or np.zeros(2),
        constraint=lambda t, q: others.append(t) or plain.constraint(t, q),
        constraint_jacobian=lambda t, q: others.append(t) or plain.constraint_jacobian(t, q),
    )
    counters = solver.solve(scene, LOOSE).counters
    counted = counters.residual_evaluations + counters.output_evaluations
    assert len(calls) <= counted <= len(calls) + len(others)
    assert counters.output_evaluations > counters.steps_accepted, "at least one for the multipliers of each row"
    compiled = solver.solve(problem(), LOOSE).counters
    assert compiled.steps_accepted == pytest.approx(counters.steps_accepted, rel=0.4)
    assert compiled.residual_evaluations > compiled.steps_accepted
    assert compiled.newton_iterations is None, "what nobody reports is not zero"
    assert "not reported" in compiled.provenance


def test_evaluations_of_ida_are_those_of_the_library(monkeypatch):
    seen = []
    monkeypatch.setattr(ida, "IDA", lying(ida.IDA, lambda result: seen.append((result.nfev, result.njev))))
    counters = ida.solver().solve(problem(), Request(rtol=1e-6, t_eval=[1.0])).counters
    assert counters.residual_evaluations == seen[-1][0] + 1  # the start's acceleration level
    assert counters.jacobian_evaluations == seen[-1][1]
    assert counters.output_evaluations == 1


@EVERY
def test_work_does_not_depend_on_how_many_rows_are_asked_for(solver):
    """Steps of Radau, DOP853 and diffrax reach rows inside a step by evaluating more: that is output, not work."""
    solutions = [solver.solve(problem(), Request(rtol=1e-6, t_eval=np.linspace(0, 1, count))) for count in (2, 211)]
    np.testing.assert_array_equal(solutions[0].q[-1], solutions[1].q[-1])
    few, many = (solution.counters for solution in solutions)
    assert many.output_evaluations >= 211 > few.output_evaluations == 2
    assert replace(many, output_evaluations=0, provenance="") == replace(few, output_evaluations=0, provenance="")


def test_budgets_count_the_evaluations_for_rows_inside_steps_too():
    solver = scipy_ivp.solver(method="DOP853")
    alone = solver.solve(problem(), Request(rtol=1e-6)).counters.residual_evaluations
    asked = Request(rtol=1e-6, t_eval=np.linspace(0, 1, 500), max_evaluations=alone + 100)
    solution = solver.solve(problem(), asked)
    assert solution.status is Status.evaluation_budget
    assert solution.counters.residual_evaluations < alone


class Watched(Growing):
    """Tells every evaluation of its force, from inside compiled code too."""

    def force(self, t, q, v):
        jax.debug.callback(lambda: watched.append(1))
        return super().force(t, q, v)


watched = []


@pytest.mark.parametrize("method", ["Tsit5", "Dopri8"])
@pytest.mark.parametrize("t_eval", [None, [0.31, 0.32, 0.9, 1.0]])
def test_evaluations_of_explicit_methods_in_compiled_code_are_those_of_the_system(method, t_eval):
    """Booked as stages times attempts; here the system itself counts."""
    scene = problem("rheonomic", system=Watched())
    solver = diffrax_ode.solver(method=method)
    solver.warm_up(scene, Request(rtol=1e-6, t_eval=t_eval))
    jax.effects_barrier()
    watched.clear()
    solution = solver.solve(scene, Request(rtol=1e-6, t_eval=t_eval))
    jax.effects_barrier()
    assert solution.success
    counters = solution.counters
    assert counters.residual_evaluations + counters.output_evaluations == len(watched)
    assert counters.residual_evaluations > counters.steps_accepted


def test_evaluations_of_an_implicit_method_in_compiled_code_come_from_a_second_run():
    asked = Request(rtol=1e-6, t_eval=[0.5, 1.0])
    solver = diffrax_ode.solver(method="Kvaerno5")
    first = solver.solve(problem(), asked)
    second = solver.count(problem(), asked)
    assert first.counters.residual_evaluations is None
    assert first.counters.output_evaluations is None
    assert second.output_evaluations > 2, "also inside steps"
    assert "in a second run" in second.provenance
    assert second.steps_accepted == first.counters.steps_accepted
    stages = 6 * (second.steps_accepted + second.steps_rejected_error)  # implicit ones, at least one evaluation each
    assert stages <= second.residual_evaluations <= 10 * stages


def test_compiled_code_is_shared_between_tolerances_and_parameters():
    def run(**request):
        TSIT5.solve(problem("rheonomic", system=Growing(growth=0.3)), Request(**request))

    run(rtol=1e-5)
    before = compiled_pieces()
    run(rtol=1e-7)
    run(rtol=1e-6, atol=1e-9, max_num_steps=3)
    run(rtol=1e-6, max_seconds=5.0)
    assert compiled_pieces() == before


@EVERY
def test_nothing_compiles_after_the_warm_up(solver):
    asked = Request(rtol=1e-6, t_eval=np.linspace(0, 1, 5))
    solver.warm_up(problem(), asked)
    before = compiled_pieces()
    assert solver.solve(problem(), asked).success
    assert compiled_pieces() == before
