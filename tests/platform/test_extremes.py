"""Numbers, specs, paths and traced values at their extremes are wrong use in words, never an overflow or a raw error."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from click.testing import CliRunner

import hhtbench as hb
from hhtbench.campaign.store import Store, load_rows
from hhtbench.catalogue.specs import canonical, parse_spec
from hhtbench.cli.main import main
from hhtbench.protocol.arguments import positive_integer, real_number
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import NumpySystem
from hhtbench.solution.request import make_request, plan_steps
from solvers.hht import HHT
from tests.hht.scenes import JAX_PENDULUM, Q0, V0

GOOGOL = 10**400  # more than a float holds
UNWRITTEN = 10**5000  # Python refuses to write so many digits


# --- numbers


@pytest.mark.parametrize(
    ("request_", "name"),
    [
        ({"step": 5e-324}, "step=4.94066e-324 s makes more than"),
        ({"step": 1e-300}, "step=1e-300 s makes more than"),
        ({"steps": GOOGOL}, "steps must be at most"),
        ({"steps": 2**60}, "steps must be at most"),
        ({"steps": UNWRITTEN}, "steps must be"),
        ({"steps": [1e308, 1e308]}, "steps must add up"),
        ({"rtol": 1e-3, "max_evaluations": 2**70}, "max_evaluations must be"),
        ({"step": 0.1, "max_evaluations": -UNWRITTEN}, "max_evaluations must be"),
        ({"rtol": 1e-3, "max_num_steps": 2**63}, "max_num_steps must be"),
        ({"step": GOOGOL}, "step must be a number that a float holds"),
        ({"rtol": 1e-3, "max_seconds": UNWRITTEN}, "max_seconds must be a number that a float holds"),
    ],
    ids=lambda value: "" if isinstance(value, dict) else value,
)
def test_a_number_too_large_to_count_or_to_hold_is_refused_by_name(request_, name):
    with pytest.raises(ProblemError, match=name) as caught:
        HHT(NumpySystem(force=lambda *_: pytest.fail("a callback was called"))).solve((0.0, 1.0), Q0, V0, **request_)
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("engine", ["compiled", "python"])
def test_the_largest_budgets_are_no_limit(engine):
    most = {"max_evaluations": 2**63 - 1, "max_num_steps": 2**63 - 1, "max_seconds": 1e308}
    assert HHT(JAX_PENDULUM, engine=engine).solve((0.0, 0.1), Q0, V0, rtol=1e-3, **most).success


def test_steps_are_counted_up_to_what_floats_count():
    assert plan_steps(make_request(step=1.0), 0.0, 1e15).count == pytest.approx(1e15, rel=1e-11)
    with pytest.raises(ProblemError, match=r"more than 2\*\*53 steps"):
        plan_steps(make_request(step=1.0), 0.0, 1e300)


def test_an_interval_longer_than_a_float_is_refused_for_every_solver():
    with pytest.raises(ProblemError, match=r"t_span from -1e.308 to 1e.308 s is longer than a float holds"):
        Problem(name="long", system=JAX_PENDULUM, t_span=(-1e308, 1e308), q0=Q0, v0=V0)
    with pytest.raises(ProblemError, match=r"tspan from -1e.308 to 1e.308 s is longer than a float holds"):
        HHT(JAX_PENDULUM).solve((-1e308, 1e308), Q0, V0, rtol=1e-3)


@pytest.mark.parametrize("value", [GOOGOL, UNWRITTEN, -UNWRITTEN], ids=["googol", "unwritten", "negative"])
def test_a_number_in_a_message_is_short(value):
    for check in (positive_integer, real_number):
        with pytest.raises(ProblemError) as caught:
            check("name", value)
        assert len(str(caught.value)) < 160


# --- specs


def test_a_spec_of_1500_summands_is_refused_and_one_of_100_is_read():
    """In a process of its own: how deep it may recurse depends on who calls."""
    code = (
        "from hhtbench.catalogue.specs import parse_spec; from hhtbench.protocol.errors import ProblemError\n"
        "assert parse_spec('a(k=' + '+'.join('1' * 100) + ')').arguments == {'k': 100}\n"
        "for text in ('a(k=' + '+'.join('1' * 1500) + ')', 'a(k=' + '[' * 80 + '1' + ']' * 80 + '+1' * 1500 + ')'):\n"
        "    try: parse_spec(text)\n"
        "    except ProblemError as error: assert 'too' in str(error) or 'must' in str(error), error\n"
        "    else: raise AssertionError(text)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_product_too_long_to_be_written_is_refused():
    with pytest.raises(ProblemError, match="a whole number is too large"):
        canonical(f"a(k={'*'.join(['2**2000'] * 5)})")
    assert parse_spec("a(k=2**2000)").arguments == {"k": 2**2000}


# --- stores


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "text.sqlite").write_text("no database at all, but text\n" * 9)
    (tmp_path / "loop").symlink_to("loop")
    return tmp_path


ODD = ["folder", "text.sqlite", "", ".", "a\0b", "x" * 300, "loop", "nofolder/x.sqlite", "text.sqlite/x", "/dev/null"]


@pytest.mark.parametrize("path", ODD, ids=lambda path: repr(path[:20]))
@pytest.mark.parametrize("use", [Store, load_rows])
def test_a_path_that_is_no_store_is_told_in_words(folder, use, path):
    with pytest.raises(ProblemError) as caught:
        use(path)
    assert "\0" not in str(caught.value)
    assert sorted(entry.name for entry in folder.iterdir() if not entry.name.endswith(".lock")) == [
        "folder",
        "loop",
        "text.sqlite",
    ]


@pytest.mark.parametrize("path", [3, None, b"runs.sqlite"], ids=str)
@pytest.mark.parametrize("use", [Store, load_rows])
def test_what_is_no_path_is_no_store(use, path):
    with pytest.raises(TypeError, match="named by the path of its file"):
        use(path)


@pytest.mark.parametrize(
    "command",
    [
        ["run", "--problems", "simple_pendulum", "--solvers", "hht", "--rtol", "1e-3", "--store", ""],
        ["run", "--problems", "simple_pendulum", "--solvers", "hht", "--steps", str(GOOGOL), "--store", "a.sqlite"],
        ["report", "--store", "", "--folder", "out"],
        ["report", "--store", "text.sqlite", "--folder", "out"],
        ["solve", "simple_pendulum", "--step", "5e-324"],
        ["solve", "simple_pendulum", "--steps", str(GOOGOL)],
        ["solve", "simple_pendulum", "--rtol", "1e-3", "--max-evaluations", str(2**70)],
        ["solve", "simple_pendulum", "--rtol", "1e-3", "--output", ""],
        ["solve", "simple_pendulum", "--step", "0.5", "--output", "/proc/x.npz"],
        ["check", "simple_pendulum", "--json", ""],
    ],
    ids=lambda command: " ".join(command)[:60],
)
def test_commands_tell_wrong_use_in_one_message(folder, command):
    result = CliRunner().invoke(main, command)
    assert result.exit_code == 2, result.output
    assert "Error: " in result.output
    assert isinstance(result.exception, SystemExit)


# --- traced values


class Rod(hb.System):
    length: object = hb.parameter(1.0)

    def force(self, t, q, v):
        return jnp.array([0.0, -9.81])

    def constraint(self, t, q):
        return jnp.stack([(q @ q - self.length**2) / 2])


def end(q0=Q0, v0=V0, length=1.0, t1=0.1, rtol=1e-3, solver=None):
    if solver is None:
        return HHT(Rod(length=length)).solve((0.0, t1), q0, v0, rtol=rtol).q[-1, 0]
    problem = Problem(name="rod", system=Rod(length=length), t_span=(0.0, t1), q0=q0, v0=v0)
    return hb.solve(problem, solver, rtol=rtol).q[-1, 0]


def through_a_closure(x):
    class Pulled(hb.System):
        def force(self, t, q, v):
            return -x * q

    return HHT(Pulled()).solve((0.0, 0.1), Q0, V0, rtol=1e-3).q[-1, 0]


@pytest.mark.parametrize("solver", [None, "hht", "ida", "cvode", "scipy", "diffrax", "projected", "collocation"])
@pytest.mark.parametrize("name", ["q0", "v0", "length", "t1", "rtol"])
def test_a_gradient_through_solve_is_refused_by_name(solver, name):
    start = {"q0": Q0, "v0": V0, "length": 1.0, "t1": 0.1, "rtol": 1e-3}[name]
    named = {"length": "a parameter of Rod", "t1": r"t_?span\[1\]"}.get(name, name)
    with pytest.raises(TypeError, match=rf"{named} is traced by JAX .*not differentiable yet.* same steps \(steps=solution"):
        jax.grad(lambda x: end(**{name: x}, solver=solver))(start)


@pytest.mark.parametrize(
    "call",
    [
        lambda: jax.jit(lambda x: end(q0=x))(Q0),
        lambda: jax.vmap(lambda x: end(length=x))(np.ones(2)),
        lambda: jax.grad(lambda x: end(q0=[x, 0.0]))(1.0),
        lambda: jax.grad(through_a_closure)(1.0),
        lambda: jax.grad(lambda x: HHT(Rod()).solve(x, Q0, V0, rtol=1e-3).q[-1, 0])(jnp.array([0.0, 0.1])),
        lambda: jax.grad(lambda x: HHT(Rod(length=x)).init_step(0.0, Q0, V0, step=0.1))(1.0),
    ],
    ids=["jit", "vmap", "list", "closure", "tspan", "init_step"],
)
def test_so_is_every_other_way_of_tracing_through_it(call):
    with pytest.raises(TypeError, match="not differentiable yet"):
        call()


# --- parameters


def test_a_parameter_without_default_after_one_with_says_what_to_do():
    with pytest.raises(TypeError, match=r"Slab: mass has no default and comes after width.*or declare it before width"):

        class Slab(hb.System):
            width: object = hb.parameter(1.0)
            mass: object = hb.parameter(doc="[kg]")

    with pytest.raises(TypeError, match=r"Longer: mass has no default and comes after length"):

        class Longer(Rod):
            mass: object = hb.parameter()


def test_parameters_without_default_come_first():
    class Slab(hb.System):
        mass: object = hb.parameter()
        width: object = hb.parameter(2.0)
        name: str = "slab"

        def force(self, t, q, v):
            return self.mass * q

    class Known(Slab):
        mass: object = hb.parameter(3.0)

    assert (float(Slab(1.0).width), float(Known().mass)) == (2.0, 3.0)
