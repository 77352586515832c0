"""What a system reads from outside of Python is read again by every process; what cannot be described is traced."""

import json
import subprocess
import sys
import threading

import numpy as np
import pytest

from hhtbench.lowering.native.outside import files_read

BODY = """
import json
from pathlib import Path
import jax.numpy as jnp
from hhtbench.protocol import System

DATA = Path(__file__).with_name("body.json")

def data(name):
    return json.loads(DATA.read_text())[name]

class Mass(System):
    @property
    def mass_matrix(self):
        return jnp.diag(jnp.asarray(data("mass")))

    def force(self, t, q, v):
        return -q

class Force(System):
    def force(self, t, q, v):
        damping = data("mass")
        return -jnp.asarray(damping) * v if any(damping) else 0.0 * q

    def derived(dynamics, t, q, v):
        return dynamics.force(t, q, v)
"""
SCRIPT = """
import sys; sys.path.insert(0, sys.argv[1])
import numpy as np
from body import Force, Mass
from hhtbench.lowering import compile_function, derive, routes

q = np.ones(2)
mass = derive(Mass(), 0.0, q, q).constant_mass
print(mass.dtype, *np.diag(mass))
dynamics = derive(Force(), 0.0, q, q)
print(*compile_function(Force.derived, dynamics)(0.0, q, q))
print(dynamics.structure.force_uses_v, *[route.route for route in routes(dynamics)])
"""
OWN = {"HHTBENCH_CACHE": "", "PATH": "/usr/bin:/bin", "OMP_NUM_THREADS": "1"}


def run(script, folder, cache):
    """Lines that ``script`` prints in a process of its own."""
    command, own = [sys.executable, "-c", script, str(folder)], OWN | {"HHTBENCH_CACHE": str(cache)}
    return subprocess.run(command, env=own, capture_output=True, text=True, check=True).stdout.splitlines()


@pytest.mark.parametrize("first", [[1, 2], [0, 0]], ids=["values", "structure"])
def test_a_file_that_a_system_reads_may_change_between_two_processes(first, tmp_path, empty_cache):
    """Whole numbers in it, too."""
    (tmp_path / "body.py").write_text(BODY)
    for mass in (first, [4, 9], [4, 9]):
        (tmp_path / "body.json").write_text(json.dumps({"mass": mass}))
        masses, force, kind = run(SCRIPT, tmp_path, empty_cache)
        assert masses.split()[0] == "float64"
        np.testing.assert_array_equal(np.array(masses.split()[1:], dtype=float), mass)
        np.testing.assert_array_equal(np.array(force.split(), dtype=float), -np.array(mass, dtype=float))
        assert kind == f"{any(mass)} native"


def test_only_files_of_this_thread_count_and_neither_code_nor_caches(tmp_path, empty_cache):
    for name in ("data.txt", "code.py"):
        (tmp_path / name).write_text("1")
    empty_cache.mkdir()
    (empty_cache / "kept").write_text("1")

    def read(*paths):
        for path in paths:
            path.read_text()

    with files_read() as outer:
        other = threading.Thread(target=read, args=(tmp_path / "data.txt",))
        other.start()
        other.join()
        read(tmp_path / "code.py", empty_cache / "kept")
        assert outer == []
        with files_read() as inner:
            read(tmp_path / "data.txt")
    assert inner == outer == [str(tmp_path / "data.txt")]
    read(tmp_path / "data.txt")
    assert len(outer) == 1


HOSTILE = """
def make():
    def helper(n):
        return 1.0 if n == 0 else helper(n - 1)
    return helper
helper = make()
=
def make():
    def helper():
        return later
    return helper
    later = 1
helper = make()
=
helper = []
helper.append(helper)
=
helper = {}
helper["own"] = helper
"""
FREE = """
from hhtbench.protocol import System

class Free(System):
    def force(self, t, q, v):
        return -q - v
"""
DERIVING = """
import importlib, sys; sys.path.insert(0, sys.argv[1])
import numpy as np
from hhtbench.lowering import derive
from hhtbench.lowering.native.sources import source_key
for i in range(4):
    free = importlib.import_module(f"hostile{i}").Free()
    print(derive(free, 0.0, np.ones(2), np.ones(2)).structure.force_uses_v, source_key(derive, None, (free,), ()))
free = importlib.import_module("plain").Free()
print(source_key(derive, None, (free,), ()) is not None)
"""


def test_a_module_that_holds_itself_or_nothing_yet_is_derived_like_any_other(tmp_path, empty_cache):
    for i, part in enumerate(HOSTILE.split("=\n")):
        (tmp_path / f"hostile{i}.py").write_text(part + FREE)
    (tmp_path / "plain.py").write_text(FREE)
    assert run(DERIVING, tmp_path, empty_cache) == 4 * ["True None"] + ["True"]
