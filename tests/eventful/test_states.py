"""First-order states and sampled inputs, against closed solutions and a few lines of SciPy."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import hhtbench as hb

STIFFNESS, DAMPING, VISCOUS = 1e5, 1e5**0.5, 0.4  # of the bristle [N/m, N s/m], of the guide [N s/m]
GAINS, ROD = np.array([3.1623, 33.0, 4.9, 7.0]), 0.5
FAMILIES = ["hht", "ida", "cvode", "scipy(method=Radau)", "diffrax(method=Dopri8)", "projected"]


def bristle_rate(z, v, xp=jnp):
    return v - xp.abs(v) * z * STIFFNESS / (1.0 + 0.5 * xp.exp(-((v / 1e-3) ** 2)))


class Slider(hb.System):
    """A mass that a spring pulls against LuGre friction."""

    def force(self, t, q, v, x):
        friction = STIFFNESS * x[0] + DAMPING * bristle_rate(x[0], v[0]) + VISCOUS * v[0]
        return jnp.stack([2.0 * (0.1 * t - q[0]) - friction])

    def state_rate(self, t, q, v, x):
        return jnp.stack([bristle_rate(x[0], v[0])])


@pytest.fixture(scope="module")
def slid():
    """Position, velocity and bristle at 20 s by SciPy's Radau."""

    def rates(t, y):
        z = bristle_rate(y[2], y[1], np)
        return [y[1], 2 * (0.1 * t - y[0]) - STIFFNESS * y[2] - DAMPING * z - VISCOUS * y[1], z]

    return solve_ivp(rates, (0, 20), [0, 0, 0], method="Radau", rtol=1e-9, atol=1e-13).y[:, -1]


@pytest.mark.parametrize("rtol", [1e-4, 1e-6])
@pytest.mark.parametrize("solver", ["hht", "projected"])
def test_a_mass_with_lugre_friction_errs_by_at_most_ten_tolerances(slid, solver, rtol):
    scales = hb.Scales(v=0.1, x=1e-5)
    problem = hb.Problem(name="slider", system=Slider(), t_span=(0, 20), q0=[0], v0=[0], x0=[0], scales=scales)
    run = hb.solve(problem, solver, rtol=rtol)
    assert run.success
    assert abs(run.q[-1, 0] - slid[0]) <= 10 * rtol
    assert abs(run.x[-1, 0] - slid[2]) <= 10 * rtol * 1e-5


class Maxwell(hb.System):
    """A mass on a spring beside a spring and a damper in series; x is the force of these."""

    def force(self, t, q, v, x):
        return -4.0 * q - x[:1]

    def state_rate(self, t, q, v, x):
        return 3.0 * v - 2.0 * x


MAXWELL = hb.Problem(name="maxwell", system=Maxwell(), t_span=(0, 2), q0=[1], v0=[0], x0=[0.5])
MATRIX = np.array([[0, 1, 0], [-4, 0, -1], [0, 3, -2]])


@pytest.mark.parametrize("solver", ["hht(alpha=-0.1)", "generalised_alpha", "rattle"])
def test_states_converge_with_order_two(solver):
    exact = expm(2 * MATRIX) @ [1, 0, 0.5]
    runs = [hb.solve(MAXWELL, solver, steps=n) for n in (200, 400)]
    errors = [np.linalg.norm([run.q[-1, 0], run.v[-1, 0], run.x[-1, 0]] - exact) for run in runs]
    assert 1.9 < np.log2(errors[0] / errors[1]) < 2.1


@pytest.mark.parametrize("solver", FAMILIES)
def test_every_solver_takes_states(solver):
    run = hb.solve(MAXWELL, solver, rtol=1e-7)
    assert run.success
    assert np.allclose([run.q[-1, 0], run.v[-1, 0], run.x[-1, 0]], expm(2 * MATRIX) @ [1, 0, 0.5], atol=1e-6)


def test_a_numpy_system_has_states_and_inputs_too():
    functions = {"force": lambda t, q, v, x, u: -4.0 * q - x + u, "state_rate": lambda t, q, v, x: 3.0 * v - 2.0 * x}
    system = hb.NumpySystem(**functions, mass_matrix=2.0)
    inputs = hb.Sampled(lambda t, q, v: 1.0, every=0.5, delay=0.2)
    problem = hb.Problem(name="numpy", system=system, t_span=(0, 1), q0=[1], v0=[0], x0=[0.5], inputs=inputs)
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = MATRIX
    matrix[1] = [-2, 0, -0.5, 0.5]
    y = expm(0.2 * matrix) @ [1, 0, 0.5, 0]
    y = expm(0.8 * matrix) @ [*y[:3], 1.0]
    run = hb.solve(problem, rtol=1e-7)
    assert np.allclose([run.q[-1, 0], run.v[-1, 0], run.x[-1, 0], run.u[-1, 0]], y, atol=1e-6)


class Block(hb.System):
    """A block on the floor, whose friction is the state x times the contact force."""

    def force(self, t, q, v):
        return jnp.stack([jnp.sin(3.0 * t), -9.81])

    def constraint(self, t, q):
        return q[1:]

    def reaction(self, t, q, lam, x):
        return jnp.stack([x[0] * lam[0], -lam[0]])  # the contact force is -lam

    def state_rate(self, t, q, v, x):
        return v[:1] - 5.0 * x


def test_a_reaction_may_depend_on_a_state():
    problem = hb.Problem(name="block", system=Block(), t_span=(0, 2), q0=[0, 0], v0=[0, 0], x0=[0])
    exact = solve_ivp(
        lambda t, y: [y[1], np.sin(3 * t) - 9.81 * y[2], y[1] - 5 * y[2]], (0, 2), [0, 0, 0], rtol=1e-10, atol=1e-12
    ).y[:, -1]
    for solver in ("hht", "ida"):
        run = hb.solve(problem, solver, rtol=1e-6)
        assert run.success
        assert np.allclose([run.q[-1, 0], run.v[-1, 0], run.x[-1, 0]], exact, atol=1e-5)


class Cart(hb.System):
    """A cart with a pole upright; q = (cart x, bob x, bob y)."""

    mass_matrix = (1.0, 0.2, 0.2)

    def force(self, t, q, v, u):
        return jnp.stack([u[0], 0.0, -0.2 * 9.81])

    def constraint(self, t, q):
        return jnp.stack([((q[1] - q[0]) ** 2 + q[2] ** 2 - ROD**2) / 2])


def balance(t, q, v):
    rate = ((v[1] - v[0]) * q[2] - (q[1] - q[0]) * v[2]) / ROD**2
    return GAINS @ [q[0], np.arctan2(q[1] - q[0], q[2]), v[0], rate]


def balanced(delay, end):
    """Position and angle of the cart at ``end`` by SciPy, piece by piece between samples (100 Hz) and their effects."""

    def rates(t, y, u):
        _, angle, speed, rate = y
        s, c = np.sin(angle), np.cos(angle)
        a = np.linalg.solve([[1.2, 0.2 * ROD * c], [c, ROD]], [u + 0.2 * ROD * rate**2 * s, 9.81 * s])
        return [speed, rate, *a]

    samples = [(i / 100, "sample", i) for i in range(round(100 * end))]
    effects = [(i / 100 + delay, "works", i) for i in range(round(100 * end))]  # after samples at the same time
    y, u, t, taken = np.array([0, 0.2, 0, 0]), 0.0, 0.0, {}
    for time, what, i in sorted((round(one[0], 9), *one[1:]) for one in (*samples, *effects, (end, "zend", 0))):
        if time > end:
            break
        if time > t:
            y, t = solve_ivp(rates, (t, time), y, args=(u,), rtol=1e-10, atol=1e-12).y[:, -1], time
        if what == "sample":
            taken[i] = GAINS @ y
        elif what == "works":
            u = taken[i]
    return y[:2]


@pytest.mark.parametrize("delay", [0.0, 0.004, 0.01, 0.023])
@pytest.mark.parametrize(
    ("solver", "rtol", "most"),  # multistep methods start with order one after every sample
    [("hht", 1e-6, 1e-5), ("ida", 1e-8, 1e-6), ("cvode", 1e-9, 1e-6), ("projected", 1e-6, 1e-9)],
)
def test_a_sampled_controller_balances_a_pole_with_any_delay(delay, solver, rtol, most):
    inputs = hb.Sampled(balance, every=0.01, delay=delay)
    q0 = [0.0, ROD * np.sin(0.2), ROD * np.cos(0.2)]
    problem = hb.Problem(name="cart", system=Cart(), t_span=(0, 0.3), q0=q0, v0=[0, 0, 0], inputs=inputs)
    run = hb.solve(problem, solver, rtol=rtol)
    q = run.q[-1]
    assert run.success
    assert np.allclose([q[0], np.arctan2(q[1] - q[0], q[2])], balanced(delay, 0.3), rtol=0, atol=most)


class Pushed(hb.System):
    """A mass of 1 kg that the first input pushes."""

    def force(self, t, q, v, u):
        return u[:1]


def test_a_controller_remembers_what_it_sampled_last():
    def law(t, q, v, u):  # proportional, integral; the second input is its integral
        total = u[1] + 0.1 * (1.0 - q[0])
        return np.array([2.0 * (1.0 - q[0]) + 0.5 * total - 2.0 * v[0], total])

    inputs = hb.Sampled(law, every=0.1, delay=0.1, start=[0.0, 0.0])
    run = hb.solve(hb.Problem(name="pi", system=Pushed(), t_span=(0, 2), q0=[0], v0=[0], inputs=inputs), rtol=1e-8)
    q, v, held, taken = 0.0, 0.0, 0.0, np.zeros(2)
    for _ in range(20):
        held, taken = taken[0], law(0, [q], [v], taken)
        q, v = q + 0.1 * v + 0.005 * held, v + 0.1 * held
    assert run.success
    assert np.allclose([run.q[-1, 0], run.v[-1, 0]], [q, v], atol=1e-9)


def test_two_inputs_have_their_own_periods():
    inputs = [hb.Sampled(lambda t, q, v: t, every=0.5, name="slow"), hb.Sampled(lambda t, q, v: 2 * t, every=0.2)]

    class Twice(hb.System):
        def force(self, t, q, v, u):
            return u[:1] + 10 * u[1:]

    run = hb.solve(
        hb.Problem(name="two", system=Twice(), t_span=(0, 1.1), q0=[0], v0=[0], inputs=inputs), "projected", rtol=1e-8
    )
    velocity = 0.5 * 0.5 + 1.0 * 0.1 + 10 * (0.4 + 0.8 + 1.2 + 1.6) * 0.2 + 10 * 2.0 * 0.1
    assert np.isclose(run.v[-1, 0], velocity, rtol=1e-9)
    assert [len(times) for times in run.t_events] == [3, 6]


def test_thousands_of_samples():
    inputs = hb.Sampled(lambda t, q, v: -v[0], every=0.001)
    half = hb.Event(lambda t, q, v: v[0] - 0.5, name="half")
    start = {"t_span": (0, 1.5), "q0": [0], "v0": [1], "inputs": inputs, "events": half}
    run = hb.solve(hb.Problem(name="many", system=Pushed(), **start), rtol=1e-6)
    assert run.t_events[0] == pytest.approx([np.log(0.5) / np.log(0.999) / 1000], abs=1e-6)
    assert run.success
    assert np.isclose(run.v[-1, 0], 0.999**1500, rtol=1e-6)


def test_states_and_inputs_go_on_through_a_switch():
    class Freed(hb.System):
        def force(self, t, q, v, x, u):
            return -x + u

        def state_rate(self, t, q, v, x):
            return 2.0 * v

    class Stuck(Freed):
        def constraint(self, t, q):
            return q - 1.0

    stuck = Stuck()
    event = hb.Event(lambda t, q, v: q[0] - 1.0, direction=1, then=stuck, name="caught")
    inputs = hb.Sampled(lambda t, q, v, x: 1.0 + x[0], every=0.25)
    start = {"q0": [0], "v0": [1], "x0": [0], "inputs": inputs}
    problem = hb.Problem(name="switch", system=Freed(), t_span=(0, 3), **start, events=event)
    for solver in ("hht", "projected"):
        run = hb.solve(problem, solver, rtol=1e-8)
        last = run.phases[-1]
        assert run.success
        assert last.system is stuck
        assert np.allclose(run.q[last.rows, 0], 1.0)
        assert np.allclose(run.x[last.rows, 0], 2.0, atol=1e-7)  # x = 2 q
        assert np.allclose(run.u[-1], 3.0, atol=1e-7)
        assert np.allclose(run.lam[-1], 1.0, atol=1e-7)


def test_states_are_kept_in_files_and_named_in_tables(tmp_path):
    pytest.importorskip("pandas")
    run = hb.solve(MAXWELL, rtol=1e-4)
    again = hb.Solution.load(run.save(tmp_path / "run.npz"))
    assert np.array_equal(again.x, run.x)
    assert [*run.to_pandas()] == ["t", "q[0]", "v[0]", "x[0]"]
    plain = hb.solve("simple_pendulum", rtol=1e-3)
    assert plain.x.shape == plain.u.shape == (plain.t.size, 0)


def test_wrong_states_and_inputs_are_refused_by_name():
    start = {"name": "wrong", "t_span": (0, 1), "q0": [0], "v0": [0]}
    with pytest.raises(hb.ProblemError, match="x0="):
        hb.Problem(system=Maxwell(), **start)
    with pytest.raises(hb.ProblemError, match="state_rate"):
        hb.Problem(system=Pushed(), x0=[0], **start)
    with pytest.raises(TypeError, match=r"hhtbench\.Sampled"):
        hb.Problem(system=Pushed(), inputs=[lambda t, q, v: 0.0], **start)
    with pytest.raises(hb.ProblemError, match="backward"):
        hb.Problem(system=Pushed(), inputs=hb.Sampled(balance, every=1), **start | {"t_span": (1, 0)})
    with pytest.raises(hb.ProblemError, match="above 0 s"):
        hb.Sampled(balance, every=0)
    with pytest.raises(hb.ProblemError, match=r"shape \(2,\), as x0; got \(1,\)"):
        hb.solve(hb.Problem(system=Slider(), x0=[0, 0], **start))
    with pytest.raises(hb.ProblemError, match=r"return shape \(\), as start; got \(2,\)"):
        hb.solve(hb.Problem(system=Pushed(), inputs=hb.Sampled(lambda t, q, v: [1.0, 2.0], every=1), **start))

    class Moving(Pushed):
        def constraint(self, t, q, u):
            return q - u

    with pytest.raises(TypeError, match="constraint cannot depend on u"):
        hb.Problem(system=Moving(), inputs=hb.Sampled(balance, every=1), **start)


class Fading(hb.System):
    """A unit mass that a state pushes, which fades."""

    def force(self, t, q, v, x):
        return x

    def state_rate(self, t, q, v, x):
        return -x


FADING = {"name": "fading", "t_span": (0, 1), "q0": [-0.2], "v0": [1], "x0": [1]}


@pytest.mark.parametrize("solver", ["hht", "cvode"])
def test_events_and_their_changes_have_the_own_coordinates(solver):
    stop = hb.Event(lambda t, q, v: q[-1], change=lambda t, q, v: (q, -0.5 * v), direction=1, name="stop")
    half = hb.Event(lambda t, q, v, x: x[0] - 0.5, name="half")
    reset = hb.Event(lambda t, q, v: t - 0.9, change=lambda t, q, v, x: (q, v, x + 1.0), direction=1, name="reset")
    run = hb.solve(hb.Problem(system=Fading(), **FADING, events=[stop, half, reset]), solver, rtol=1e-8)
    assert run.success
    assert run.t_events[1] == pytest.approx([np.log(2)], abs=1e-6)
    assert run.x[-1, 0] == pytest.approx(np.exp(-1) + np.exp(-0.1), abs=1e-6)
    assert run.t_events[0].size == 1


def test_a_problem_with_states_is_changed_like_any_other():
    problem = hb.Problem(system=Fading(), **FADING)
    again = dataclasses.replace(problem, x0=[7], scales=hb.Scales(x=3.0))
    assert again.v0.tolist() == [1, 7]
    assert again.scales.v.tolist() == [1.0, 3.0]
    moved = problem.starting(q0=[0.5], v0=[2.0])
    assert (moved.q0[0], moved.v0.tolist()) == (0.5, [2.0, 1.0])
    run = hb.solve(problem, rtol=1e-8, q0=[0.5])
    assert run.q[0, 0] == 0.5
    onward = problem.starting((1, 2), run.q[-1], run.v[-1])
    assert onward.x0 == pytest.approx(run.x[-1])
    inputs = hb.Sampled(lambda t, q, v: 1.0, every=0.1)
    pushed = hb.Problem(system=Pushed(), name="pushed", t_span=(0, 1), q0=[0], v0=[0], inputs=inputs)
    slower = dataclasses.replace(pushed, inputs=hb.Sampled(lambda t, q, v: 2.0, every=0.5))
    assert hb.solve(slower, rtol=1e-6).q[-1, 0] == pytest.approx(1.0)
    with pytest.raises(hb.ProblemError, match="make a new Problem"):
        dataclasses.replace(pushed, inputs=hb.Sampled(lambda t, q, v: 2.0, every=0.5, delay=0.5))
    with pytest.raises(hb.ProblemError, match="backward"):
        hb.solve(pushed, t_span=(1, 0))
    with pytest.raises(hb.ProblemError, match=r"must have shape \(1,\), or \(2,\)"):
        problem.starting(q0=[1, 2, 3])


def test_a_system_without_a_law_of_the_states_keeps_them():
    class Still(hb.System):
        def force(self, t, q, v, x):
            return 0 * x - v

    event = hb.Event(lambda t, q, v: t - 0.5, direction=1, then=Still(), name="still")
    run = hb.solve(hb.Problem(system=Fading(), **FADING, events=event), rtol=1e-8)
    assert run.success
    assert np.allclose(run.x[run.phases[1].rows], np.exp(-0.5), atol=1e-6)


def test_campaigns_and_trades_take_sampled_inputs():
    found = hb.trade(HELD, accuracies=[1e-3], seconds=20, solvers=["hht", "projected"])
    assert "Take" in found.sentence


HELD = hb.Problem(
    name="held",
    system=Pushed(),
    t_span=(0, 1),
    q0=[1],
    v0=[0],
    inputs=hb.Sampled(lambda t, q, v: -4 * q[0] - 3 * v[0], every=0.1),
)


def test_functions_in_the_wrong_form_are_refused():
    class Swapped(hb.System):  # a state that is named where coordinates stand
        def force(self, t, x, v, u):
            return u - x

    inputs = hb.Sampled(lambda t, x, v: -x[0], every=0.1)
    start = {"name": "swapped", "t_span": (0, 1), "q0": [1], "v0": [0], "inputs": inputs}
    assert hb.solve(hb.Problem(system=Swapped(), **start), rtol=1e-6).success

    class Mixed(Block):
        def reaction(self, t, q, x, lam):
            return jnp.stack([x[0] * lam[0], -lam[0]])

    with pytest.raises(TypeError, match="behind lam"):
        hb.Problem(name="mixed", system=Mixed(), t_span=(0, 2), q0=[0, 0], v0=[0, 0], x0=[0])

    class Deaf(hb.System):
        def force(self, t, q, v):
            return -q

    class Heavy(Pushed):
        mass_matrix: object = hb.parameter([1.0, 2.0, 3.0])

    with pytest.raises(hb.ProblemError, match="no function takes u"):
        hb.Problem(system=Deaf(), **start)
    with pytest.raises(hb.ProblemError, match=r"mass_matrix must be a number, \(1,\) or \(1, 1\); got \(3,\)"):
        hb.solve(hb.Problem(system=Heavy(), **start), rtol=1e-4)
    with pytest.raises(hb.ProblemError, match=r"scales\.q must be a number or have shape \(1,\)"):
        hb.Problem(system=Pushed(), **start, scales=hb.Scales(q=[1, 1, 1]))
    with pytest.raises(hb.ProblemError, match="takes no exact"):
        hb.Problem(system=Pushed(), **start, exact=lambda t: None)


def test_a_description_names_states_and_inputs():
    text = str(hb.describe(HELD))
    assert text.startswith("held: Pushed")
    assert "0 states, 1 inputs" in text
