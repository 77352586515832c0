"""``projected(engine=compiled)``: SciPy's steps where nothing is projected, both levels at every row, orders, failures."""

import signal
import threading
from dataclasses import replace
from itertools import pairwise

import diffrax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hhtbench as hb
from hhtbench.lowering import ConstraintLevels, derive
from hhtbench.protocol.system import System
from hhtbench.solution.counting import Clock
from hhtbench.solution.request import Request
from hhtbench.solution.result import Status
from solvers._run import Halt, Run
from solvers.explicit.march import march
from solvers.explicit.steps import NOTHING, CompiledSteps
from solvers.explicit.tableaux import CLASSES, Tsit5
from solvers.kernel import memory as mem
from solvers.kernel.memory import view
from tests.adapters.scenes import numpy_ring, problem

METHODS = tuple(CLASSES)
CONSTRAINED = (
    "simple_pendulum",
    "planar_chain(n_links=3)",
    "andrews",
    "bead_on_rotating_rod",
    "knife_edge",
    "heavy_top",
    "position",
    "rheonomic",
    "variable mass",
    "mixed",
    "velocity",
)


class Swing(System):
    """An angle, and a spring that hardens: nothing is constrained."""

    def force(self, t, q, v):
        return jnp.stack([-9.81 * jnp.sin(q[0]) + 0.3 * q[1], -q[1] - 2 * q[1] ** 3 + jnp.cos(2 * t)])


def swing(t_span=(0.0, 10.0)):
    return hb.Problem(name="swing", system=Swing(), t_span=t_span, q0=[1.5, 0.2], v0=[0.0, 1.0])


TIMES, PLACES = np.array([0.0, 1.0, 2.5, 4.0, 6.0]), np.array([0.0, 0.0, 3.0, 2.0, 2.0])


class Table(System):
    """A load on a rope of 2 m below a trolley whose positions a table gives: its velocity jumps at 1, 2.5 and 4 s."""

    def mass_matrix(self, t, q):
        return jnp.diag(jnp.array([20.0, 5.0, 5.0]))

    def force(self, t, q, v):
        return jnp.stack([0.0, 0.0, -5.0 * 9.81])

    def constraint(self, t, q):
        return jnp.stack([q[0] - jnp.interp(t, TIMES, PLACES), ((q[1] - q[0]) ** 2 + q[2] ** 2 - 4) / 2])


def table():
    return hb.Problem(name="table", system=Table(), t_span=(0.0, 6.0), q0=[0, 0, -2], v0=[0, 0, 0])


def end_of_table():
    """q and v (3,) at 6 s: the rope's angle a'' = -(g / l) sin a from kink to kink, where it jumps by l a' -> -dV cos a.

    The impulse acts on the load along the rope, so that its velocity across it stays.
    """
    speeds, angle = np.diff(PLACES) / np.diff(TIMES), np.zeros(2)
    for before, speed, t0, t1 in zip([0.0, *speeds], speeds, TIMES[:-1], TIMES[1:], strict=False):
        angle[1] -= (speed - before) * np.cos(angle[0]) / 2
        angle = solve_ivp(lambda _, y: [y[1], -9.81 / 2 * np.sin(y[0])], (t0, t1), angle, rtol=1e-13, atol=1e-14).y[:, -1]
    (a, rate), x, v = angle, PLACES[-1], speeds[-1]
    return np.array([x, x + 2 * np.sin(a), -2 * np.cos(a)]), np.array([v, v + 2 * rate * np.cos(a), 2 * rate * np.sin(a)])


def loaded(name):
    return hb.load_problem(name) if "_" in name or name == "andrews" else problem(name)


def begun(of, **request):
    """A run before its first step."""
    run = Run("test", of, Request(**request), "ode", Clock())
    assert run._begin() is None
    return run


@pytest.mark.parametrize("rtol", [1e-3, 1e-6])
@pytest.mark.parametrize("t_span", [(0.0, 10.0), (3.0, -4.0)])
@pytest.mark.parametrize("method", METHODS)
def test_steps_are_scipys_where_nothing_is_projected(method, t_span, rtol):
    """Each step from the same place to roundoff; over a run estimates of few digits let lengths differ a little."""
    found = hb.solve(swing(t_span), f"projected(method={method})", rtol=rtol, atol=rtol / 10)
    assert found.status is Status.success

    def rhs(t, y):
        return np.concatenate([y[2:], np.asarray(Swing().force(t_span[0] + t, y[:2], y[2:]))])

    def scipys(k, **first_step):
        y0, rest = np.concatenate([found.q[k], found.v[k]]), t_span[1] - t_span[0]
        return CLASSES[method](rhs, found.t[k] - t_span[0], y0, rest, rtol=rtol, atol=rtol / 10, **first_step)

    for k in range(0, found.t.size - 1, 5):
        solver = scipys(k, first_step=abs(found.t[k + 1] - found.t[k]))
        solver.step()
        np.testing.assert_allclose(solver.t, found.t[k + 1] - t_span[0], rtol=1e-14)
        np.testing.assert_allclose(solver.y, np.concatenate([found.q[k + 1], found.v[k + 1]]), rtol=1e-12, atol=1e-13)
    whole, times = scipys(0), [0.0]
    while whole.status == "running":
        whole.step()
        times.append(whole.t)
    assert found.t.size == len(times)
    np.testing.assert_allclose(found.t - t_span[0], times, rtol=1e-5)
    assert found.counters.residual_evaluations == whole.nfev + 1, "the start's, for its check"


def test_the_coefficients_of_tsit5_are_those_of_diffrax():
    tableau = diffrax.Tsit5.tableau
    a = [row[: k + 1] for k, row in enumerate(Tsit5.A[1:])]
    for ours, theirs in zip([*a, Tsit5.B], tableau.a_lower, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-14)
    np.testing.assert_allclose([*Tsit5.C[1:], 1.0], tableau.c, rtol=0, atol=1e-14)
    np.testing.assert_allclose(Tsit5.E, tableau.b_error, rtol=0, atol=1e-13)


@pytest.mark.parametrize(("method", "order", "counts"), [("DOP853", 8, (8, 16, 32)), ("Tsit5", 5, (32, 64, 128))])
def test_projection_keeps_the_order_of_constant_steps(method, order, counts):
    """On the simple pendulum, over its first second; the error is not looked at."""
    pendulum = hb.load_problem("simple_pendulum")
    pendulum = hb.Problem(name="p", system=pendulum.system, t_span=(0, 1), q0=pendulum.q0, v0=pendulum.v0)
    exact = hb.solve(pendulum, "projected(engine=python)", rtol=3e-14, atol=1e-15).q[-1]
    errors = []
    for count in counts:
        steps = CompiledSteps(begun(pendulum, rtol=1e-3), method)
        view(steps.z, mem.ATOL)[:] = 1e30
        steps.advance(0, NOTHING, np.empty((0, 5)))
        for _ in range(count):
            view(steps.z, mem.CONTROL)[mem.H_NEXT] = 1 / count
            assert steps.advance(1, NOTHING, np.empty((1, 5))) == mem.CONVERGED
        errors.append(np.abs(steps.y[:2] - exact).max())
    orders = [np.log2(coarse / fine) for coarse, fine in pairwise(errors)]
    assert all(order - 0.5 < found < order + 1.5 for found in orders), (orders, errors)


@pytest.mark.parametrize("output", [False, True])
@pytest.mark.parametrize("name", CONSTRAINED)
@pytest.mark.parametrize("method", ["DOP853", "Tsit5"])
def test_every_row_holds_both_levels_to_roundoff(method, name, output):
    of = loaded(name)
    t0, t1 = of.t_span
    times = np.linspace(t0, t1, 23) if output else None
    found = hb.solve(of, f"projected(method={method})", rtol=1e-4, t_eval=times)
    assert found.status is Status.success, found.message
    assert "Python" not in found.message
    levels, scales = ConstraintLevels(derive(of.system, t0, of.q0, of.v0)), of.scales
    for t, q, v in list(zip(found.t, found.q, found.v, strict=True))[1:]:
        at = levels.at(float(t), q, v)
        assert at.scaled_position(scales.q).max(initial=0.0) < 1e-14
        assert at.scaled_velocity(scales.v).max() < 1e-13


@pytest.mark.filterwarnings("ignore:redundant constraints")
def test_rows_that_depend_on_others_are_left_out_and_hold_all_the_same():
    of = hb.load_problem("redundant_pendulum")
    found = hb.solve(of, "projected", rtol=1e-5)
    levels = ConstraintLevels(derive(of.system, 0.0, of.q0, of.v0))
    assert found.status is Status.success
    worst = [levels.at(float(t), q, v) for t, q, v in zip(found.t, found.q, found.v, strict=True)]
    assert max(at.scaled_position(1.0).max() for at in worst) < 1e-13


@pytest.mark.parametrize("name", ["andrews", "planar_chain(n_links=10)", "knife_edge"])
def test_both_engines_make_the_same_steps(name):
    of = hb.load_problem(name)
    compiled, python = (hb.solve(of, f"projected(engine={engine})", rtol=1e-6) for engine in ("compiled", "python"))
    assert compiled.t.size == python.t.size
    np.testing.assert_allclose(compiled.t, python.t, rtol=0, atol=1e-8 * of.t_span[1])
    np.testing.assert_allclose(compiled.q[-1], python.q[-1], rtol=0, atol=1e-8 * np.max(of.scales.q))
    np.testing.assert_allclose(compiled.lam[-1], python.lam[-1], rtol=1e-5, atol=1e-6)


KINKED = {1e-2: 2e-2, 1e-3: 1.6e-3, 1e-4: 3.5e-4, 1e-6: 7.5e-6, 1e-8: 5e-8, 1e-10: 2.4e-9}  # rtol: error of q and v


@pytest.mark.parametrize("engine", ["compiled", "python"])
@pytest.mark.parametrize("rtol", KINKED)
def test_kinks_of_a_prescribed_motion_are_seen(rtol, engine):
    found = hb.solve(table(), f"projected(engine={engine})", rtol=rtol)
    assert found.status is Status.success
    for x, right in zip((found.q[-1], found.v[-1]), end_of_table(), strict=True):
        np.testing.assert_allclose(x, right, rtol=0, atol=KINKED[rtol])


@pytest.mark.parametrize("method", METHODS)
def test_errors_at_kinks_fall_with_the_tolerance_for_every_method(method):
    q, v = end_of_table()
    errors = []
    for rtol in (1e-4, 1e-6, 1e-8):
        found = hb.solve(table(), f"projected(method={method})", rtol=rtol)
        errors.append(np.abs(np.concatenate([found.q[-1] - q, found.v[-1] - v])).max())
    assert np.all(np.array(errors) <= [1e-2, 1e-4, 1e-6]), errors


def test_both_engines_reject_the_same_steps_at_kinks():
    of = replace(table(), v0=np.array([0.0, 0.5, 0.0]))  # of a start at rest the first step hangs on roundoff
    compiled, python = (hb.solve(of, f"projected(engine={engine})", rtol=1e-6) for engine in ("compiled", "python"))
    assert compiled.counters.steps_rejected_error > 40
    assert compiled.t.size == python.t.size
    np.testing.assert_allclose(compiled.t, python.t, rtol=0, atol=1e-6)
    np.testing.assert_allclose(compiled.q[-1], python.q[-1], rtol=0, atol=1e-7)


@pytest.mark.parametrize("engine", ["compiled", "python"])
def test_a_jump_of_a_prescribed_position_is_told(engine):
    class Jump(Table):
        def constraint(self, t, q):
            return super().constraint(t, q) - jnp.stack([0.1 * (t > 0.7), 0.0])

    of = hb.Problem(name="jump", system=Jump(), t_span=(0, 2), q0=[0, 0, -2], v0=[0, 0, 0])
    found = hb.solve(of, f"projected(engine={engine})", rtol=1e-6)
    assert found.status is Status.step_too_small
    assert found.t[-1] == pytest.approx(0.7, abs=1e-6)


@pytest.mark.parametrize("engine", ["compiled", "python"])
def test_a_start_that_is_consistent_to_fewer_digits_than_the_tolerance_is_no_kink(engine):
    of = hb.load_problem("simple_pendulum")
    found = hb.solve(
        replace(of, q0=of.q0 * (1 + 4e-9), reference=None), f"projected(engine={engine})", rtol=1e-11, atol=1e-12
    )
    assert found.status is Status.success, found.message


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["swing", "andrews", "mixed"])
def test_output_times_leave_the_steps_as_they_are_and_rows_are_as_accurate(name, method):
    of = swing() if name == "swing" else loaded(name)
    free = hb.solve(of, f"projected(method={method})", rtol=1e-5)
    times = np.sort(np.append(np.linspace(*of.t_span, 300), free.t[[1, -2]]))
    asked = hb.solve(of, f"projected(method={method})", rtol=1e-5, t_eval=times)
    exact = hb.solve(of, "projected(engine=python)", rtol=1e-11, t_eval=times)
    np.testing.assert_array_equal(asked.t, times)
    np.testing.assert_array_equal(asked.q[np.searchsorted(times, free.t[[1, -2]])], free.q[[1, -2]])
    assert asked.counters.steps_accepted == free.counters.steps_accepted
    assert asked.counters.residual_evaluations == free.counters.residual_evaluations
    at_steps = hb.solve(of, "projected(engine=python)", rtol=1e-11, t_eval=free.t)
    assert np.abs(asked.q - exact.q).max() <= 2 * np.abs(free.q - at_steps.q).max()


def test_more_rows_in_one_step_than_a_call_has_room_for_are_all_there():
    of = problem("unconstrained", t_span=(0.0, 2.0))
    times = np.linspace(0.0, 2.0, 5000)
    found = hb.solve(of, "projected", rtol=1e-8, t_eval=times)
    assert found.status is Status.success
    np.testing.assert_allclose(found.q[:, 0], np.cos(2 * times), atol=1e-6)
    free = hb.solve(of, "projected", rtol=1e-8).counters
    assert found.counters.steps_accepted == free.steps_accepted, "no step is made twice"
    assert found.counters.residual_evaluations == free.residual_evaluations


@pytest.mark.parametrize(("of", "count"), [(hb.load_problem("planar_chain(n_links=3)"), 4), (table(), 25)])
def test_the_same_bits_come_out_twice_and_as_plain_python(of, count):
    """Of the table the first kink and what is rejected before it are among the steps."""
    first, second = (hb.solve(of, "projected", rtol=1e-6) for _ in range(2))
    np.testing.assert_array_equal(np.hstack([first.q, first.v, first.lam]), np.hstack([second.q, second.v, second.lam]))
    rows = []
    for plain in (False, True):
        steps, kept = CompiledSteps(begun(of, rtol=1e-6), "DOP853"), np.empty((count, 1 + 2 * of.q0.size))
        steps.z.i[mem.EVALUATIONS] = 10**6
        entry = march.function if plain else march
        assert entry(steps.z, steps.method, steps.room, steps.run.t1, count, NOTHING, kept) == mem.CONVERGED
        rows.append(kept)
    np.testing.assert_allclose(rows[0], rows[1], rtol=1e-13, atol=1e-14)


LIES = {
    "not finite": (1.0, np.array([np.nan, 0.0, 0.0, 0.0]), Status.unreliable),
    "nowhere": (0.0, np.zeros(4), Status.step_too_small),
}


@pytest.mark.parametrize("lie", LIES)
def test_many_steps_at_once_are_looked_at_like_single_ones(lie):
    t, y, status = LIES[lie]
    run = begun(hb.load_problem("simple_pendulum"), rtol=1e-3)
    with pytest.raises(Halt) as caught:
        run.accept_many(3, t, y, np.empty((0, 5)))
    assert caught.value.status is status
    assert run.work.counters().steps_accepted == 0


@pytest.mark.parametrize("times", [None, np.linspace(0, 5, 77)])
def test_no_more_steps_are_taken_than_allowed(times):
    whole = hb.solve(swing(), "projected", rtol=1e-6, t_eval=times)
    found = hb.solve(swing(), "projected", rtol=1e-6, max_num_steps=7, t_eval=times)
    assert found.status is Status.max_steps
    assert found.counters.steps_accepted == 7
    assert 1 <= found.t.size < whole.t.size
    np.testing.assert_array_equal(found.q, whole.q[: found.t.size])


def test_an_interrupt_leaves_the_steps_before_it():
    of = hb.Problem(name="long", system=Swing(), t_span=(0, 1e7), q0=[1.5, 0.2], v0=[0.0, 1.0])
    hb.solve(of, "projected", rtol=1e-6, max_num_steps=1)
    timer = threading.Timer(0.5, lambda: signal.raise_signal(signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt) as caught:
        hb.solve(of, "projected", rtol=1e-6, t_eval=[0.0, 1e7])
    timer.join()
    assert caught.value.partial_solution.counters.steps_accepted > 100


def test_a_time_budget_ends_a_long_run_soon():
    of = hb.Problem(name="long", system=Swing(), t_span=(0, 1e7), q0=[1.5, 0.2], v0=[0.0, 1.0])
    hb.solve(of, "projected", rtol=1e-6, max_num_steps=1)
    found = hb.solve(of, "projected", rtol=1e-6, max_seconds=0.3)
    assert found.status is Status.deadline
    assert found.counters.steps_accepted > 100


def test_what_is_not_machine_code_is_stepped_in_python_and_said():
    of = numpy_ring()
    found = hb.solve(of, "projected", rtol=1e-3, max_num_steps=5)
    assert "The steps are made in Python: the functions are plain callables" in found.message
    assert hb.solve(of, "projected(engine=python)", rtol=1e-3, max_num_steps=5).t.tolist() == found.t.tolist()


@pytest.mark.parametrize("name", ["planar_chain(n_links=40)", "fput_chain(n_masses=200)"])
def test_large_systems_are_stepped_by_the_compiled_loop_as_in_python(name):
    """By the entries of their KKT matrix, or without constraints."""
    of = hb.load_problem(name)
    of = replace(of, t_span=(0.0, 0.1), reference=None)
    compiled, plain = (hb.solve(of, f"projected(engine={e})", rtol=1e-8, t_eval=[0.05, 0.1]) for e in ("compiled", "python"))
    assert "in Python" not in compiled.message
    assert compiled.counters.steps_accepted == plain.counters.steps_accepted
    np.testing.assert_allclose(compiled.q, plain.q, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(compiled.lam, plain.lam, rtol=0.0, atol=1e-7 * np.abs(plain.lam).max(initial=1.0))
    levels = ConstraintLevels(derive(of.system, 0.0, of.q0, of.v0))
    for t, q, v in zip(compiled.t, compiled.q, compiled.v, strict=True):
        assert levels.at(float(t), q, v).hold(q, v, 1e-12)


def test_an_error_too_large_to_be_squared_shortens_the_step():
    """Stages that are finite and huge, as those of stiff contacts: the size of their error is no number."""

    class Wall(hb.System):
        def force(self, t, q, v):
            return 1e170 * jnp.sign(q - 1.0) * (q > 1.0) * (v > -1.0)

    problem = hb.Problem(name="wall", system=Wall(), t_span=(0.0, 1.0), q0=[0.0], v0=[2.0])
    solution = hb.solve(problem, "projected", rtol=1e-3, atol=1e-3, max_evaluations=20_000)
    assert solution.status is Status.step_too_small
    assert solution.t[-1] == pytest.approx(0.5)
