"""Machine code on disk: found again by its content alone, in a folder that nobody else can write."""

import os
import subprocess
import sys

import numpy as np
import pytest

import hhtbench.lowering.scalar_compiler.compiler  # noqa: F401 - by its module below
from hhtbench.lowering import flattening, native
from hhtbench.lowering.caching import Cache
from hhtbench.lowering.scalar_compiler import native_call
from hhtbench.lowering.scalar_compiler.machine import generate
from tests.lowering.native import Nothing

compiler = sys.modules["hhtbench.lowering.scalar_compiler.compiler"]  # the name in the package is the function's
X = np.array([0.3, -1.2])

MECHANISM = """
from pathlib import Path
from hhtbench.protocol import System

HERE = Path(__file__).parent
{setup}

class Mechanism(System):
    def force(self, t, q, v):
        return -{stiffness} * q

    def constraint(self, t, q):
        return q[:1] - q[1:]
"""
READ = "def read():\n    return float((HERE / 'k.txt').read_text())\n"
WAYS = {  # a module each, whose other contents are the same in every process
    "lru_cache": (f"import functools\n{READ}read = functools.lru_cache(read)\nread()", "read()"),
    "environment": ("import os", "float(os.environ['SPRING_K'])"),
    "attribute": (f"{READ}read.k = read()", "read.k"),
    "changed": ("from spring import STIFFNESS", "STIFFNESS"),
}
SOLVERS = "hht", "ida", "cvode", "scipy(method=Radau)", "diffrax", "projected", "collocation"
ASKED = [(way, solver) for way in WAYS for solver in SOLVERS if way == "lru_cache" or solver == "hht"]
ASKED.append(("changed", "diffrax"))  # whose code XLA keeps
SCRIPT = """
import importlib, sys; sys.path.insert(0, sys.argv[1])
import hhtbench as hb

for way, solver in {asked}:
    system = importlib.import_module(way + "_mechanism").Mechanism()
    problem = hb.Problem(name="spring", system=system, t_span=(0, 1), q0=[1, 1], v0=[0, 0])
    print(way, solver, hb.solve(problem, solver, rtol=1e-4).q[-1, 0], sep="|")
"""


def new_process(folder, k):
    """(way, solver) -> q(1) of a spring of stiffness ``k`` that is read in four ways, as a new process finds it."""
    (folder / "k.txt").write_text(str(k))
    (folder / "spring.py").write_text(f"STIFFNESS = {k}")
    command = [sys.executable, "-c", SCRIPT.format(asked=ASKED), str(folder), str(k)]
    own = {"SPRING_K": str(k), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, env=os.environ | own, capture_output=True, text=True, check=False)
    assert not done.returncode, done.stderr
    return {(way, solver): float(q) for way, solver, q in (line.split("|") for line in done.stdout.splitlines())}


def test_a_new_process_sees_what_its_system_reads_by_whatever_way(tmp_path):
    """lru_cache, environment, an attribute and a changed file; the first by every solver."""
    for name, (setup, stiffness) in WAYS.items():
        (tmp_path / f"{name}_mechanism.py").write_text(MECHANISM.format(setup=setup, stiffness=stiffness))
    for k, exact in ((1.0, np.cos(1.0)), (4.0, np.cos(2.0))):
        found = new_process(tmp_path, k)
        assert len(found) == len(ASKED)
        for where, q in found.items():
            assert q == pytest.approx(exact, abs=1e-3), where


def cubed(dynamics, x):
    return 2.0 * x**3


def value_afresh(monkeypatch, function=cubed):
    """Value, and whether no code was generated, as if the process were new."""
    generated = []
    for module, name in ((compiler, "_memory"), (compiler, "_last"), (flattening, "_jitted")):
        monkeypatch.setattr(module, name, Cache(64))
    monkeypatch.setattr(compiler, "generate", lambda *text: generated.append(text) or generate(*text))
    code = native(function, Nothing(), shapes=((2,),))
    return native_call(code, ((2,),))(X), not generated


def test_equal_computations_share_code_whatever_their_source(monkeypatch, empty_cache):
    assert not value_afresh(monkeypatch)[1]
    for function in (cubed, lambda dynamics, x: 2.0 * x**3):
        value, cached = value_afresh(monkeypatch, function)
        assert cached
        np.testing.assert_allclose(value, 2.0 * X**3, rtol=1e-14)
    assert not value_afresh(monkeypatch, lambda dynamics, x: 3.0 * x**3)[1]


@pytest.mark.parametrize(
    "damage", [lambda data: b"", lambda data: data[:-1], lambda data: data[:-1] + bytes([data[-1] ^ 1])]
)
def test_a_damaged_file_is_as_good_as_none(damage, monkeypatch, empty_cache):
    expected, _ = value_afresh(monkeypatch)
    (file,) = (empty_cache / "native").iterdir()
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    value, cached = value_afresh(monkeypatch)
    np.testing.assert_array_equal(value, expected)
    assert not cached
    assert file.read_bytes() == whole, "the damaged file was replaced"


def test_a_folder_that_cannot_be_written_does_no_harm(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("HHTBENCH_CACHE", str(tmp_path / "file"))
    value, cached = value_afresh(monkeypatch)
    np.testing.assert_allclose(value, 2.0 * X**3, rtol=1e-14)
    assert not cached


def test_the_folder_of_code_is_its_owners_alone(monkeypatch, empty_cache):
    value_afresh(monkeypatch)
    for folder in (empty_cache, empty_cache / "native"):
        assert folder.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("place", ["", "native"], ids=["the cache", "native"])
@pytest.mark.parametrize("mode", [0o770, 0o707])
def test_a_folder_that_others_can_write_is_refused_with_a_message(mode, place, monkeypatch, empty_cache):
    value_afresh(monkeypatch)
    (empty_cache / place).chmod(mode)
    with pytest.warns(UserWarning, match="can be written by others; run chmod go-w"):
        assert not value_afresh(monkeypatch)[1], "nothing of it is run"


def test_a_folder_of_somebody_else_is_refused_with_a_message(monkeypatch, empty_cache):
    value_afresh(monkeypatch)
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    with pytest.warns(UserWarning, match="not to you; set HHTBENCH_CACHE to a folder of your own"):
        assert not value_afresh(monkeypatch)[1]
