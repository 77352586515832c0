"""What an import of hhtbench loads and what it does to JAX, in processes of their own."""

import json
import pickle
import pkgutil
import subprocess
import sys

import pytest

import hhtbench
from hhtbench import Request
from hhtbench.cli.main import main
from hhtbench.runtime.processes import worker_processes

HEAVY = ("jax", "numpy", "scipy", "matplotlib", "plotly", "rich")
GROUPS = {"reference": ("build", "check", "show"), "study": ("selection", "acceptance", "atlas", "stability")}
PRECISION = """
import json, os
import jax, jax.numpy as jnp
asynchronous = jax.config.read("jax_cpu_enable_async_dispatch")
print(json.dumps([jnp.array([1.0]).dtype.name, asynchronous, "JAX_ENABLE_X64" in os.environ]))
"""


def _last_line(code: str) -> object:
    """What the last line of the output of ``code`` says, in a new process."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


HELP = """
import click
from hhtbench.cli.main import main
heavy = {}
for words in (["--help"], ["list"], *([name, "--help"] for name in main.commands), *(SUBCOMMANDS)):
    try:
        main(words)
    except SystemExit:
        heavy[" ".join(words)] = [name for name in HEAVY if name in sys.modules]
print(json.dumps(heavy))
"""
SUBCOMMANDS = [[name, word, "--help"] for name, words in GROUPS.items() for word in words]


def test_the_list_and_the_help_of_every_command_load_no_heavy_library():
    """One process for all of them: what one loads, all that follow have."""
    heavy = _last_line(f"import json, sys\nHEAVY, SUBCOMMANDS = {HEAVY}, {SUBCOMMANDS}\n{HELP}")
    assert {"--help", "list", "study acceptance --help", *(f"{name} --help" for name in main.commands)} <= heavy.keys()
    assert {words: found for words, found in heavy.items() if found} == {}


def test_a_system_is_declared_without_what_draws_and_without_plugins():
    absent = "[name for name in ('matplotlib', 'plotly', 'solvers', 'problems') if name in sys.modules]"
    assert _last_line(f"import json, sys, hhtbench as hb\nhb.System, hb.solve\nprint(json.dumps({absent}))") == []


@pytest.mark.parametrize(
    "first",
    [
        "import hhtbench",
        "import jax.numpy, hhtbench",
        "from hhtbench import System",
        "import hhtbench.protocol.errors, importlib.util; importlib.util.find_spec('jax')",
        f"import pickle; pickle.loads({pickle.dumps(Request(step=0.1))!r})",
    ],
)
def test_jax_has_64_bits_whichever_is_imported_first_and_the_environment_stays_as_it_is(first):
    assert _last_line(f"{first}\n{PRECISION}") == ["float64", False, False]


def test_jax_has_64_bits_in_the_worker_of_a_pool():
    with worker_processes(1) as pool:
        assert pool.submit(eval, "__import__('jax').numpy.array([1.0]).dtype.name").result() == "float64"


def test_every_public_name_is_there_and_no_module_can_take_its_place():
    assert set(hhtbench.__all__) <= set(dir(hhtbench))
    assert all(getattr(hhtbench, name).__name__ == name for name in hhtbench.__all__ if name != "__version__")
    assert not {module.name for module in pkgutil.iter_modules(hhtbench.__path__)} & set(hhtbench.__all__)


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="'hhtbench' has no attribute 'sovle'"):
        hhtbench.sovle  # noqa: B018


LINES = """
import json, sys
import numpy as np, jax.numpy as jnp, hhtbench as hb
class Own(hb.System):
    def force(self, t, q, v): return jnp.stack([0.0, -9.81])
    def constraint(self, t, q): return jnp.stack([(q @ q - 1) / 2])
called = hb.NumpySystem(force=lambda t, q, v: np.array([0.0, -9.81]), constraint=lambda t, q: np.array([(q @ q - 1) / 2]))
start = {"t_span": (0.0, 0.1), "q0": [1.0, 0.0], "v0": [0.0, 0.0]}
problem = KIND
assert hb.solve(problem, "scipy(method=Radau)", t_span=(0.0, 0.1)).success
own = [m.__file__ for n, m in sys.modules.items() if n.split(".")[0] in ("hhtbench", "solvers", "problems") if m.__file__]
print(sum(len(open(file).readlines()) for file in own))
"""


@pytest.mark.parametrize(
    ("kind", "most"),
    [
        ("hb.Problem(name='p', system=called, **start)", 7_890),
        ("hb.Problem(name='p', system=Own(), **start)", 10_850),
        ("'simple_pendulum'", 11_100),
    ],
)
def test_a_solve_by_a_library_imports_no_more_lines_than_it_needs(kind, most):
    """Plain callables need neither compilers nor loops, no solve needs judge, drift and accuracy before it is asked for."""
    assert _last_line(LINES.replace("KIND", kind)) <= most
