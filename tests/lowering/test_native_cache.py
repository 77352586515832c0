"""Machine code on disk: a new process neither traces nor compiles, and whatever changes the meaning is seen."""

import subprocess
import sys
import types

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.special

import hhtbench.lowering.native.compiler  # noqa: F401 - by its module below
from hhtbench.lowering import NotNative, flattening, native
from hhtbench.lowering.native.calling import native_call
from hhtbench.lowering.native.sources import source_key
from tests.lowering.native import Holding, Nothing

compiler = sys.modules["hhtbench.lowering.native.compiler"]  # the name in the package is the function's
X = np.array([0.3, -1.2])
FACTOR = 2.0
TRACED = []

MECHANISM = """
import jax.numpy as jnp
from spring import pull
from hhtbench.protocol import System, parameter

class Mechanism(System):
    k: object = parameter(3.0)

    def force(self, t, q, v):
        print("traced")
        return pull(self.k, q)

def force_of(dynamics, q):
    return dynamics.force(0.0, q, 0.0 * q)
"""
SPRING = "def pull(k, q):\n    return -{factor} * k * q**3\n"
SCRIPT = """
import numpy as np
import hhtbench
from hhtbench.lowering import native
from hhtbench.lowering.native.calling import native_call
from mechanism import Mechanism, force_of
code = native(force_of, Mechanism(), shapes=((2,),))
print(*native_call(code, ((2,),))(np.array([1.0, 2.0])), code.cached)
"""


def run_script(folder, cache):
    """What a new process prints."""
    command = "import sys; sys.path.insert(0, sys.argv[1])\n" + SCRIPT
    environment = {"HHTBENCH_CACHE": str(cache), "PATH": "/usr/bin:/bin", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", command, str(folder)], env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


def test_a_new_process_does_not_trace_until_an_imported_source_changes(tmp_path, empty_cache):
    (tmp_path / "mechanism.py").write_text(MECHANISM)
    (tmp_path / "spring.py").write_text(SPRING.format(factor=1))
    assert run_script(tmp_path, empty_cache) == ["traced", "-3.0", "-24.0", "False"]
    assert run_script(tmp_path, empty_cache) == ["-3.0", "-24.0", "True"]
    (tmp_path / "spring.py").write_text(SPRING.format(factor=2))
    assert run_script(tmp_path, empty_cache) == ["traced", "-6.0", "-48.0", "False"]


def cubed(dynamics, x):
    TRACED.append(1)
    return FACTOR * x**3


def forget(monkeypatch):
    """As if the process were new."""
    for module, name in ((compiler, "_memory"), (compiler, "_last"), (flattening, "_jitted")):
        monkeypatch.setattr(module, name, {})
    TRACED.clear()


def value_afresh(monkeypatch, function=cubed, dynamics=Nothing()):  # noqa: B008 - it holds nothing
    """Value, whether no code was generated, and how often it was traced, as if the process were new."""
    forget(monkeypatch)
    code = native(function, dynamics, shapes=((2,),))
    return native_call(code, ((2,),))(X), code.cached, len(TRACED)


def test_a_replaced_constant_is_seen(monkeypatch, empty_cache):
    first, *_ = value_afresh(monkeypatch)
    monkeypatch.setattr(sys.modules[__name__], "FACTOR", 5.0)
    second, cached, traced = value_afresh(monkeypatch)
    np.testing.assert_allclose(second, 2.5 * first, rtol=1e-14)
    assert (cached, traced) == (False, 1)
    monkeypatch.setattr(sys.modules[__name__], "FACTOR", 2.0)
    third, cached, traced = value_afresh(monkeypatch)
    np.testing.assert_array_equal(third, first)
    assert (cached, traced) == (True, 0)


TABLE = {"k": [2.0]}


class Held:
    k = 2.0


def enclosing(k):
    def inner(x):
        return k * x

    return inner


enclosed = enclosing(2.0)


def from_a_table(dynamics, x):
    TRACED.append(1)
    return TABLE["k"][0] * x


def from_a_class(dynamics, x):
    TRACED.append(1)
    return Held.k * x


def from_a_closure(dynamics, x):
    TRACED.append(1)
    return enclosed(x)


@pytest.mark.parametrize(
    ("function", "change"),
    [
        (from_a_table, lambda patch: patch.setitem(TABLE, "k", [5.0])),
        (from_a_class, lambda patch: patch.setattr(Held, "k", 5.0)),
        (from_a_closure, lambda patch: patch.setattr(sys.modules[__name__], "enclosed", enclosing(5.0))),
    ],
    ids=["dict", "class", "closure"],
)
def test_what_a_module_was_given_at_run_time_is_part_of_the_key(function, change, monkeypatch, empty_cache):
    """A table read from a file, an attribute of a class, a number in a closure: the sources do not tell of them."""
    first, *_ = value_afresh(monkeypatch, function)
    change(monkeypatch)
    np.testing.assert_allclose(value_afresh(monkeypatch, function)[0], 2.5 * first, rtol=1e-14)


@pytest.mark.parametrize("damage", [b"", b"is nothing that exists", b"garbage \xff\x00", b"is ../../x"])
def test_a_damaged_file_is_as_good_as_none(damage, monkeypatch, empty_cache):
    expected, *_ = value_afresh(monkeypatch)
    for file in (empty_cache / "native").iterdir():
        file.write_bytes(damage if file.suffix == ".key" else file.read_bytes())
    np.testing.assert_array_equal(value_afresh(monkeypatch)[0], expected)
    for file in (empty_cache / "native").iterdir():
        data = bytearray(file.read_bytes())
        data[-1] ^= 255
        file.write_bytes(damage or bytes(data))
    value, cached, traced = value_afresh(monkeypatch)
    np.testing.assert_array_equal(value, expected)
    assert (cached, traced) == (False, 1)
    assert value_afresh(monkeypatch)[1:] == (True, 0), "the damaged files were replaced"


def test_a_folder_that_cannot_be_written_does_no_harm(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("HHTBENCH_CACHE", str(tmp_path / "file"))
    value, cached, traced = value_afresh(monkeypatch)
    np.testing.assert_allclose(value, FACTOR * X**3, rtol=1e-14)
    assert (cached, traced) == (False, 1)


def sorted_entries(dynamics, x):
    TRACED.append(1)
    return jnp.sort(x)


def test_a_refusal_is_remembered_too(monkeypatch, empty_cache):
    for traces in (1, 0):
        forget(monkeypatch)
        with pytest.raises(NotNative, match="sort"):
            native(sorted_entries, Nothing(), shapes=((2,),))
        assert len(TRACED) == traces


def test_equal_computations_share_code_whatever_their_source(monkeypatch, empty_cache):
    value_afresh(monkeypatch)
    value, cached, _ = value_afresh(monkeypatch, function=lambda dynamics, x: 2.0 * x**3)
    assert cached
    np.testing.assert_allclose(value, 2.0 * X**3, rtol=1e-14)


def key(function=cubed, dynamics=Nothing(), static=()):  # noqa: B008 - it holds nothing
    return source_key(function, dynamics, static, ())


class Shaped(eqx.Module):
    values: object
    power: object = eqx.field(static=True, default=2)


def test_sources_have_a_key_that_tells_meanings_apart():
    keys = [
        key(),
        key(static=(1,)),
        key(static=(1.0,)),
        key(static=("1",)),
        key(static=(True,)),
        key(static=(None,)),
        key(function=sorted_entries),
        key(dynamics=Shaped(jnp.ones(2))),
        key(dynamics=Shaped(jnp.ones(3))),
        key(dynamics=Shaped(jnp.ones(2), 3)),
        key(dynamics=Shaped(np.arange(2))),
        key(dynamics=Shaped(np.arange(1, 3))),
        key(dynamics=Holding(jnp.ones(2))),
    ]
    assert None not in keys
    assert len(set(keys)) == len(keys)
    assert key(dynamics=Shaped(jnp.ones(2))) == key(dynamics=Shaped(2 * jnp.ones(2))), "values of parameters do not count"


def test_what_cannot_be_told_from_outside_has_no_key(monkeypatch):
    class Local(eqx.Module):
        pass

    assert key(function=lambda dynamics, x: x) is None
    assert key(dynamics=Local()) is None
    assert key(dynamics=Shaped(jnp.ones(2), lambda x: x)) is None
    assert key(dynamics=Shaped(jnp.ones(2), types.SimpleNamespace(a=1))) is None
    assert key(static=(object(),)) is None


def test_functions_of_numpy_and_scipy_are_told_by_their_names(monkeypatch):
    keys = [key(static=(function,)) for function in (np.sin, np.cos, scipy.special.ellipk)]
    assert None not in keys
    assert len(set(keys)) == 3
    assert key(static=(np.frompyfunc(lambda x: x, 1, 1),)) is None


def test_a_replaced_function_changes_the_key(monkeypatch):
    before = key()
    monkeypatch.setattr(sys.modules[__name__], "value_afresh", lambda: None)
    assert key() != before


def test_a_source_changed_after_the_start_of_the_process_has_no_key(monkeypatch):
    from hhtbench.lowering.native import sources

    monkeypatch.setattr(sources, "STARTED", 0.0)
    assert key() is None
