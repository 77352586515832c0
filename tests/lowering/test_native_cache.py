"""Machine code on disk: found again by its content alone, in a folder that nobody else can write."""

import os
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
