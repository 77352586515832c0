"""Functions of larger systems, by products and entries, against those of full matrices."""

import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench
from hhtbench.lowering import NotNative, compile_function, derive
from hhtbench.lowering.caching import Cache
from hhtbench.lowering.dynamics import products
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import System
from hhtbench.solution.result import Status
from solvers import _xla_call
from solvers.forms import eliminated, form, make_form
from solvers.forms.layout import Layout, jacobian_function, residual_function
from solvers.forms.underlying import rhs_function, rhs_jacobian_function
from solvers.kernel import kkt
from tests.forms.scenes import C, moment_of
from tests.lowering.systems import Pendulum
from tests.sample import slow

ROUNDOFF = 1e-12
CONSTRAINED = ("bead_chain", "four_bars", "planar_chain", "rolling_disk_incline")
DAES = [  # each of one with every second of the other
    (name, form)
    for i, name in enumerate((*CONSTRAINED, "fekete"))
    for j, form in enumerate(("ggl", "index1", "integrated"))
    if (i + j) % 2 == 0
]
FULL_MASS = (
    "andrews",
    "clamped_bar_impact",
    *(pytest.param(x, marks=pytest.mark.long) for x in ("bricard", "flyball_governor")),
)


@pytest.fixture(autouse=True)
def every_system_counts_as_large(monkeypatch):
    monkeypatch.setattr(products, "FULL", 0)
    monkeypatch.setattr(form, "_made", Cache(64))


def difference(found, expected):
    """The largest, in units of the largest entry."""
    return np.abs(np.asarray(found) - expected).max() / np.abs(expected).max()


@pytest.mark.parametrize(("name", "form_name"), [*DAES, ("oscillator_chain", "index1")])
def test_a_dae_form_by_products_is_that_of_full_matrices(name, form_name):
    moment = moment_of(hhtbench.load_problem(name))
    layout, made = Layout(form_name, moment.dynamics.structure), make_form(form_name, moment.dynamics)
    y, yp = moment.random.normal(size=(2, layout.size))
    full = [compile_function(f, moment.dynamics, layout) for f in (residual_function, jacobian_function)]
    assert made.pattern is not None
    assert difference(made.residual(moment.t, y, yp), full[0](moment.t, y, yp)) < ROUNDOFF
    jacobian = made.jacobian(moment.t, y, yp, C)
    assert jacobian.shape == made.pattern.rows.shape
    assert difference(made.matrix(jacobian), full[1](moment.t, y, yp, C)) < ROUNDOFF
    assert difference(made.matrix(jacobian, full=False).toarray(), full[1](moment.t, y, yp, C)) < ROUNDOFF


@pytest.mark.parametrize("name", [*CONSTRAINED, "oscillator_chain", "fput_chain"])
def test_the_underlying_ode_by_entries_is_that_of_full_matrices(name, monkeypatch):
    """Unconstrained too: then its Jacobian is sparse.  Else it is solved for five columns at a time, the last fewer."""
    monkeypatch.setattr(eliminated, "BLOCK", 5)
    moment = moment_of(hhtbench.load_problem(name))
    made, y = make_form("ode", moment.dynamics), np.concatenate([moment.q, moment.v])
    assert (made.pattern is None) == moment.dynamics.structure.constrained
    full = [compile_function(f, moment.dynamics)(moment.t, y) for f in (rhs_function, rhs_jacobian_function)]
    assert difference(made.rhs(moment.t, y), full[0]) < ROUNDOFF
    assert difference(made.matrix(made.rhs_jacobian(moment.t, y)), full[1]) < ROUNDOFF


@pytest.mark.parametrize("name", [*FULL_MASS, "planar_chain"])
@pytest.mark.parametrize("compiled", [True, False])
def test_masses_that_are_no_diagonal_and_systems_without_machine_code_have_the_same_ode(name, compiled, monkeypatch):
    moment = moment_of(hhtbench.load_problem(name))
    if not compiled:
        monkeypatch.setattr(kkt, "kkt_code", refuse)
    made, y = make_form("ode", moment.dynamics), np.concatenate([moment.q, moment.v])
    assert difference(made.rhs(moment.t, y), compile_function(rhs_function, moment.dynamics)(moment.t, y)) < ROUNDOFF


def refuse(*_):
    """As machine code that is not known how to make."""
    raise NotNative("refused")


def test_a_singular_kkt_matrix_gives_values_that_are_not_finite_and_no_exception():
    """At the pivot the rod has no direction, and the matrix of (F9) a row of zeros."""
    made = make_form("ode", derive(Pendulum(), 0.0, np.array([0.6, 0.8]), np.zeros(2)))
    y = np.array([0.0, 0.0, 1.0, 2.0])
    assert not np.isfinite(made.rhs(0.0, y)[2:]).any()
    assert not np.isfinite(made.rhs_jacobian(0.0, y)[2:]).any()


@pytest.fixture
def threads_in_turn_all_the_time():
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


@pytest.mark.usefixtures("threads_in_turn_all_the_time")
def test_threads_share_a_form():
    problem = hhtbench.load_problem("planar_chain")
    made = make_form("ode", derive(problem.system, 0.0, problem.q0, problem.v0))
    places = [np.concatenate([problem.q0 + 1e-2 * i, problem.v0 + i]) for i in range(8)]
    alone = [made.rhs(0.0, y) for y in places]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda i: made.rhs(0.0, places[i % 8]), range(4000)))
    for i, found in enumerate(together):
        np.testing.assert_array_equal(found, alone[i % 8])


SOLVERS = ("ida(form=index1)", "cvode", "scipy(method=Radau)", "scipy(method=BDF)", "scipy(method=LSODA)")
RUNS = [(name, solver) for name in ("planar_chain", "oscillator_chain") for solver in SOLVERS]


OTHERS = ("ida(form=ggl)", "scipy(method=DOP853)", "diffrax(method=Kvaerno5)")


@pytest.mark.parametrize(
    ("name", "solver"), [*RUNS, *(("planar_chain", x) if "Kvaerno5" not in x else slow("planar_chain", x) for x in OTHERS)]
)
def test_a_library_with_sparse_functions_goes_the_way_it_goes_with_full_ones(name, solver, monkeypatch):
    """The same steps but for roundoff, which the chain magnifies, with sparse matrices where it takes them."""
    problem = hhtbench.load_problem(name)

    def solved():
        return hhtbench.solve(problem, solver, rtol=1e-6, max_num_steps=30)

    sparse = solved()
    monkeypatch.setattr(products, "FULL", 10**6)
    monkeypatch.setattr(form, "_made", Cache(64))
    full = solved()
    assert sparse.status is full.status
    assert full.counters.residual_evaluations in (sparse.counters.residual_evaluations, None)
    np.testing.assert_allclose(sparse.t, full.t, rtol=1e-6)
    np.testing.assert_allclose(sparse.q, full.q, rtol=0, atol=1e-9)
    np.testing.assert_allclose(sparse.lam, full.lam, rtol=0, atol=1e-6)


class Falling(System):
    """Four weights on rods, until one has fallen too far."""

    def force(self, t, q, v):
        """Gravity, and NaN below a height."""
        return jnp.where(q[3] < -0.1, jnp.nan, -9.81) * jnp.tile(jnp.array([0.0, 1.0]), 4)

    def constraint(self, t, q):
        """Lengths of the rods."""
        return (jnp.sum(q.reshape(4, 2) ** 2, axis=1) - 1.0) / 2


@pytest.mark.parametrize("solver", ["ida(form=ggl)", "cvode", "scipy(method=DOP853)", "diffrax(method=Tsit5)"])
def test_a_force_that_is_not_finite_is_named(solver):
    problem = Problem(name="falling", system=Falling(), t_span=(0.0, 1.0), q0=np.tile([1.0, 0.0], 4), v0=np.zeros(8))
    found = hhtbench.solve(problem, solver, rtol=1e-6)
    assert found.status is Status.nonfinite_callback
    assert "force" in found.message


def test_what_compiled_code_calls_is_counted_and_keeps_the_budget():
    """With output between the steps; the counters of XLA's own code are None for an implicit method."""
    problem = replace(hhtbench.load_problem("planar_chain"), t_span=(0.0, 0.05))
    asked = {"rtol": 1e-4, "t_eval": np.linspace(0.0, 0.05, 12)}
    found = hhtbench.solve(problem, "diffrax(method=Kvaerno5)", **asked)
    assert found.success
    assert found.counters.residual_evaluations > 5 * found.counters.steps_accepted
    assert found.counters.output_evaluations > 5 * 10
    assert found.counters.jacobian_evaluations >= found.counters.steps_accepted
    ended = hhtbench.solve(problem, "diffrax(method=Kvaerno5)", **asked, max_evaluations=30)
    assert ended.status is Status.evaluation_budget
    assert ended.counters.residual_evaluations == 30


@pytest.mark.parametrize("error", [ZeroDivisionError("in y'"), KeyboardInterrupt()], ids=repr)
def test_what_is_raised_under_compiled_code_comes_out_of_the_solve(error, monkeypatch):
    problem, calls = hhtbench.load_problem("planar_chain"), []

    def raising(_, *place):
        calls.append(place)
        if len(calls) == 10:
            raise error
        return np.concatenate([place[1][24:], np.zeros(24)])

    monkeypatch.setattr(eliminated.Eliminated, "rhs", raising)
    with pytest.raises(type(error)) as raised:
        hhtbench.solve(problem, "diffrax(method=Tsit5)", rtol=1e-6)
    assert raised.value is error
    assert len(calls) == 10
    assert raised.value.partial_solution.t.size > 0


def test_an_interrupt_under_compiled_code_ends_the_solve(monkeypatch):
    """Where Python would deliver it between two lines of what C has called, and lose it."""
    calls, arrays_of = [], _xla_call._arrays

    def interrupted(buffers):
        calls.append(buffers)
        if len(calls) == 10:
            signal.raise_signal(signal.SIGINT)
        return arrays_of(buffers)

    monkeypatch.setattr(_xla_call, "_arrays", interrupted)
    with pytest.raises(KeyboardInterrupt) as raised:
        hhtbench.solve("planar_chain", "diffrax(method=Tsit5)", rtol=1e-6)
    assert raised.value.partial_solution.t.size > 0
