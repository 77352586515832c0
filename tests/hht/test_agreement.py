"""One loop, however it is run: compiled or as plain Python, with machine code or with callbacks, in every linear algebra."""

import ast

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench import ProblemError, Status
from hhtbench.lowering import NotNative
from hhtbench.protocol.events import Event
from solvers.hht import HHT
from solvers.hht.equations.coefficients import REACTIONS
from solvers.hht.run import functions
from solvers.hht.sources import SOURCES
from solvers.hht.verify import rivals
from tests.hht.scenes import Q0, SYSTEMS, V0, Ball, forget_engines
from tests.sample import LIBRARY, slow

STEPS = 20
CLOSE = 1e-9  # of the largest: roundoff of two ways to compute the same functions, carried over the steps
RECOVERED = 1e-12  # of the largest: multipliers of the rows are found in another way around compiled loops
METHODS = [
    {"alpha": -0.3},
    {"alpha": -0.3, "b": 0.25},
    {"alpha": -0.15, "reaction": "predictor"},
    {"alpha": -0.15, "reaction": "midpoint"},
    {"alpha": 0.0, "reaction": "midpoint_predictor"},
    {"alpha": -0.1, "start": "shifted"},
    {"alpha": -0.2, "start": "trapezoidal", "rescale_a": False},
]
RIVALS = ("ggl", "index3", "extended", "hht_i3", "rattle")
EXTRAPOLATED = ({}, {"b": 0.2}, *({"reaction": name} for name in REACTIONS[1:]))
MIXED = ["jay_negrut_pendulum", "andrews", "rolling_disk_incline", "jay_negrut_test1", "knife_edge", "oscillator_chain"]


def solve(problem, span=None, options=None, kind=HHT, **request):
    guesses = {"lam_guess": problem.lam_guess, "mu_guess": problem.mu_guess}
    hht = kind(problem.system, **(options or {}))
    return hht.solve(span or problem.t_span, problem.q0, problem.v0, **guesses, **request)


def both(problem, span=None, options=None, **request):
    """Compiled, and as plain Python."""
    return [solve(problem, span, {**(options or {}), "engine": name}, **request) for name in ("compiled", "python")]


def assert_bits(compiled, plain):
    """Every step and every count are the same; the multipliers of rows, found after them, to roundoff."""
    texts = [found.message.partition(" Differences took")[0] for found in (compiled, plain)]  # Python calls more
    assert (compiled.status, texts[0]) == (plain.status, texts[1])
    for name in ("t", "q", "v"):
        np.testing.assert_array_equal(getattr(compiled, name), getattr(plain, name), err_msg=name)
    assert compiled.counters == plain.counters
    for name in ("lam", "mu"):
        ours, theirs = getattr(compiled, name), getattr(plain, name)
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=RECOVERED * np.abs(theirs).max(initial=0.0), err_msg=name)


def assert_close(one, other, close=CLOSE):
    assert one.status is other.status, (one.message, other.message)
    assert one.t.size == other.t.size
    assert one.counters.steps_accepted == other.counters.steps_accepted
    for name in ("q", "v", "lam", "mu"):
        ours, theirs = getattr(one, name), getattr(other, name)
        bound = close * (1.0 if name in "qv" else 1e3) * max(float(np.abs(theirs).max(initial=0.0)), 1e-12)
        assert np.abs(ours - theirs).max(initial=0.0) <= bound, name


# --- compiled and plain Python


@pytest.mark.parametrize("name", LIBRARY)
def test_every_problem_moves_the_same_with_constant_steps_and_under_error_control(name):
    problem = hb.load_problem(name)
    t0, t1 = problem.t_span
    h = 1e-4 * (t1 - t0)
    compiled, plain = both(problem, (t0, t0 + STEPS * h), step=h)
    assert compiled.counters.steps_accepted == STEPS
    assert_bits(compiled, plain)
    compiled, plain = both(problem, rtol=1e-4, max_num_steps=STEPS)
    assert compiled.counters.steps_accepted == STEPS
    assert_bits(compiled, plain)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        *((name, options) for i, name in enumerate(MIXED) for j, options in enumerate(METHODS) if (i + j) % 4 == 0),
        *(slow(x, options) for i, x in enumerate(MIXED) for j, options in enumerate(METHODS) if (i + j) % 4 == 2),
        *(("simple_pendulum", {"extrapolate_reaction": True, **options}) for options in EXTRAPOLATED),
    ],
    ids=str,
)
def test_every_method_moves_the_same(name, options):
    """Each of the problems with every fourth of the methods (slow: every second), and extrapolated multipliers."""
    problem = hb.load_problem(name)
    t0, t1 = problem.t_span
    lengths = 1e-4 * (t1 - t0) * np.resize([1.0, 1.0, 0.5, 1.4, 1.4, 1.4], STEPS)
    assert_bits(*both(problem, (t0, t0 + float(lengths.sum())), options, steps=lengths))
    assert_bits(*both(problem, None, options, rtol=1e-3, max_num_steps=STEPS))


HOW = ({"step": 1e-3}, {"rtol": 1e-4})
LIGHT = "stiff_spring_pendulum(stiffness=1e10, m1=1e-6)"  # a light mass, where two engines once ended differently
ALGEBRA = ("dense", "band", "sparse")  # machine code for 5 links, callbacks into XLA for 40
WAYS = [
    *(
        ("simple_pendulum", (0.0, 0.3), rivals.METHODS[name][1], {"kind": rivals.METHODS[name][0], "steps": 30})
        for name in RIVALS
    ),
    *(("jay_negrut_pendulum", (0.0, -0.05), {}, how) for how in HOW),
    *(
        (f"planar_chain(n_links={n})", None, {"linsolver": x}, {"rtol": 1e-3, "max_num_steps": 5})
        for n in (5, 40)
        for x in ALGEBRA
    ),
    *((LIGHT, (0.0, 1000 * h), {"alpha": 0.0}, {"steps": 1000}) for h in (1e-5, 8e-6)),
    *(
        ("jay_negrut_pendulum", None, {}, {"steps": 1000, **budget})
        for budget in ({"max_evaluations": 100}, {"max_num_steps": 17})
    ),
]


@pytest.mark.parametrize(("name", "span", "options", "request_"), WAYS, ids=str)
def test_every_way_moves_the_same(name, span, options, request_):
    """Methods of the field, time backward, every linear algebra, a mass ratio of a million, and runs cut by a budget."""
    compiled, plain = both(hb.load_problem(name), span, options, **request_)
    assert_bits(compiled, plain)
    cut = {"max_evaluations": Status.evaluation_budget, "max_num_steps": Status.max_steps}
    assert compiled.status is next((cut[limit] for limit in cut if limit in request_), Status.success)


@pytest.mark.parametrize("how", HOW, ids=str)
def test_functions_in_python_move_the_same(how):
    runs = (HHT(SYSTEMS["numpy"], engine=name).solve((0.0, 0.3), Q0, V0, **how) for name in ("compiled", "python"))
    assert_bits(*runs)


@pytest.mark.parametrize(
    ("name", "request_"), [("kapitza_pendulum", {"steps": 10}), ("planar_chain", {"rtol": 1e-2, "max_num_steps": 40})]
)
def test_restarted_and_damped_iterations_are_the_same(name, request_):
    """Small systems by whole corrections, larger ones by factors."""
    compiled, plain = both(hb.load_problem(name), **request_)
    assert compiled.counters.steps_rejected_newton > 0
    assert_bits(compiled, plain)


def test_events_come_at_the_same_times():
    height = Event(lambda t, q, v: q[1] + 0.3)
    bounce = Event(lambda t, q, v: q[0] - 0.4, change=lambda t, q, v: (q, -v))
    for how in ({"step": 0.01}, {"rtol": 1e-5}):
        compiled, plain = (
            HHT(SYSTEMS["jax"], engine=engine, events=[height, bounce]).solve((0.0, 2.0), Q0, V0, **how)
            for engine in ("compiled", "python")
        )
        assert_bits(compiled, plain)
        assert sum(t.size for t in compiled.t_events) > 1
        for ours, theirs in zip(compiled.t_events, plain.t_events, strict=True):
            np.testing.assert_array_equal(ours, theirs)
        assert compiled.counters.event_evaluations > 0


class Vanishing(hb.System):
    """A free mass whose force is no number beyond q = 1/2."""

    def force(self, t, q, v):
        return jnp.where(q < 0.5, -q, jnp.nan)


def test_a_force_that_jumps_to_nan_ends_both_with_the_same_words_and_counters():
    compiled, plain = (
        HHT(Vanishing(), engine=engine).solve((0.0, 1.0), [0.0], [1.0], step=0.01) for engine in ("compiled", "python")
    )
    assert_bits(compiled, plain)
    assert compiled.status is Status.nonfinite_callback
    assert compiled.t[-1] == pytest.approx(0.52, abs=0.011)  # arcsin(1/2)


# --- machine code and callbacks


def called_back(monkeypatch):
    """From here on no system has machine code of its steps."""

    def refuse(*_, **__):
        raise NotNative("none is wanted")

    monkeypatch.setattr(functions, "native", refuse)
    forget_engines(monkeypatch)


@pytest.mark.parametrize("name", [*MIXED, "planar_chain"])
def test_functions_that_are_called_back_move_a_system_as_machine_code_does(monkeypatch, name):
    """Values of every function of every problem are compared in tests/lowering/test_native_agreement.py."""
    problem = hb.load_problem(name)
    t0, t1 = problem.t_span
    h = 1e-4 * (t1 - t0)
    constant, controlled = ((t0, t0 + 30 * h), {"step": h}), (problem.t_span, {"rtol": 1e-4, "max_num_steps": 30})
    native = [solve(problem, span, **how) for span, how in (constant, controlled)]
    called_back(monkeypatch)
    other = [solve(problem, span, **how) for span, how in (constant, controlled)]
    assert_close(native[0], other[0])
    iterations = pytest.approx(
        other[0].counters.newton_iterations, rel=0.05, abs=3
    )  # the last one is often roundoff's choice
    assert native[0].counters.newton_iterations == iterations
    assert_close(native[1], other[1], close=1e-7)  # steps follow the error, roundoff follows them


def used(system, q0=Q0, v0=V0, **options):
    hht = HHT(system, **options)
    assert hht.solve((0.0, 0.01), q0, v0, step=0.01).success
    return hht.engine_used


def test_the_engine_that_was_used_is_said(monkeypatch):
    pendulum, chain = (hb.load_problem(name) for name in ("jay_negrut_pendulum", "planar_chain(n_links=40)"))
    start = pendulum.q0, pendulum.v0
    assert used(pendulum.system, *start) == "compiled loops, machine code, inverse matrix"
    assert used(SYSTEMS["numpy"]) == "compiled loops, machine code, inverse matrix"
    assert used(pendulum.system, *start, engine="python") == "plain Python loops, machine code, inverse matrix"
    assert used(pendulum.system, *start, linsolver="sparse") == "compiled loops, machine code, sparse matrix"
    assert used(chain.system, chain.q0, chain.v0) == "compiled loops, machine code, band matrix"
    called_back(monkeypatch)
    assert used(pendulum.system, *start) == "compiled loops, functions in Python, dense matrix"
    with pytest.raises(ProblemError, match="engine must be one of compiled, python"):
        HHT(pendulum.system, engine="fortran")


# --- what stays in the loops, and what does not


@pytest.mark.parametrize("engine", ["compiled", "python"])
def test_an_event_over_a_number_that_changes_is_seen_to_change(engine):
    """Its machine code holds the number: it stops at 0.1, which another event makes of it on the way, and not at -0.9."""
    level = -0.9

    def arm(t, q, v):
        nonlocal level
        level = 0.1
        return q, v

    events = [Event(lambda t, q, v: q[0] - 0.35, change=arm), Event(lambda t, q, v: q[0] - level, terminal=True)]
    solution = HHT(SYSTEMS["jax"], engine=engine, events=events).solve((0.0, 3.0), Q0, V0, step=0.01)
    assert solution.status is Status.event
    assert solution.q[-1, 0] == pytest.approx(0.1, abs=1e-12)


class TwoMasses(hb.System):
    """Springs between two masses and a wall; the declared Jacobian says that there are none."""

    stiffness: object = hb.parameter(1e6)

    def force(self, t, q, v):
        return jnp.stack([-self.stiffness * (2 * q[0] - q[1]), -self.stiffness * (q[1] - q[0])])

    def force_jacobians(self, t, q, v):
        return jnp.zeros((2, 2)), jnp.zeros((2, 2))


@pytest.mark.parametrize("engine", ["compiled", "python"])
def test_entries_that_a_wrong_jacobian_leaves_out_come_back_with_the_derived_one(engine):
    with pytest.warns(UserWarning, match="failed with the declared force_jacobians and converged without"):
        solution = HHT(TwoMasses(), alpha=-0.3, engine=engine).solve((0.0, 0.1), [1.0, 0.5], [0.0, 0.0], step=0.01)
    assert solution.success


@pytest.mark.parametrize("level", [0.7, 0.5, 0.3])
def test_the_matrix_of_a_step_that_ends_at_an_event_filters_the_next_error_too(level):
    """The next step meets the ground: by the ground's own matrix alone it would look exact."""

    def passes(t, q, v):
        return q[0] - level

    hht = HHT(Ball(), alpha=-0.1, events=Event(passes, terminal=True))
    hht.init_step(0.0, np.array([1.0]), np.array([0.0]), rtol=1e-3)
    while hht.step() is not Status.event:
        pass
    before = hht.state
    hht.step()
    after = hht.state
    fall = before.q[0] + before.v[0] * after.h - 9.81 / 2 * after.h**2
    assert after.q[0] == pytest.approx(fall, abs=1e-2), "the step that met the ground was taken again, shorter"


def test_what_is_compiled_squares_by_products():
    """``x ** 2`` is a product in machine code and a call of pow in Python, which rounds otherwise once in a thousand."""
    files = [file for source in SOURCES for file in (sorted(source.glob("*.py")) if source.is_dir() else [source])]
    nodes = [(file.name, node) for file in files for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))]
    assert len(files) > 10
    whole = lambda node: isinstance(node, ast.Constant) and isinstance(node.value, int)  # noqa: E731
    powers = [
        (name, node.lineno)
        for name, node in nodes
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow) and whole(node.right)
    ]
    assert powers == []
