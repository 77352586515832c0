"""Claims that hold for every registered problem."""

import ast
import functools
import importlib
import inspect
import json
import pickle
import re
import subprocess
import sys

import equinox as eqx
import jax
import numpy as np
import pytest

from hhtbench.catalogue.registry import list_problems, load_problem
from hhtbench.protocol.problem import TAGS
from hhtbench.protocol.system import declared
from tests.problems.cases import CHANGED, FURTHER
from tests.problems.mechanics import Mechanics, compiled
from tests.sample import slow

every_problem = pytest.mark.parametrize("name", list_problems())
default = functools.cache(load_problem)


def _start(problem):
    return problem.t_span[0], problem.q0, problem.v0


@every_problem
def test_problem_is_described(name):
    """Its name, its source, tags of the one list, and one sentence on what it is good for."""
    problem = default(name)
    assert problem.name == name
    assert problem.source
    assert problem.tags
    assert len(set(problem.tags)) == len(problem.tags)
    assert set(problem.tags) <= set(TAGS)
    assert problem.observables, "what is there to look at?"
    assert re.fullmatch(r"[^\n]{20,}", problem.good_for), "good_for must be one sentence"
    assert not re.search(r"[.!?] [A-Z]", problem.good_for), "more than one sentence"


@every_problem
def test_docstrings_draw_the_mechanism_and_name_every_parameter(name):
    module = importlib.import_module(f"problems.{name}")
    blocks = re.findall(r"::\n\n((?:    .*\n|\n)+)", inspect.getdoc(module) + "\n")
    assert max(len(block.splitlines()) for block in blocks) >= 3, "no indented sketch after ::"
    assert re.search(r"[\[(/]", module.__doc__)
    told = module.problem.__doc__
    assert [key for key in inspect.signature(module.problem).parameters if not re.search(rf"\b{key}\b", told)] == []
    lines = [ast.get_docstring(node) for node in ast.parse(inspect.getsource(module)).body if isinstance(node, ast.ClassDef)]
    assert all(lines)


@every_problem
def test_tags_are_true(name):
    """Those that the declared functions show."""
    problem = default(name)
    system, tags = problem.system, set(problem.tags)
    position, velocity = (declared(system, name) is not None for name in ("constraint", "velocity_constraint"))
    assert ("unconstrained" in tags) == (not position and not velocity)
    assert not {"holonomic", "velocity-level", "mixed"} <= tags
    if "mixed" in tags:
        assert position
        assert velocity
    if position and not velocity:
        assert "holonomic" in tags
        assert "velocity-level" not in tags
    if velocity and not position:
        assert "velocity-level" in tags
        assert "holonomic" not in tags
    assert ("nonlinear reaction" in tags) <= hasattr(system, "reaction")
    assert ("variable mass" in tags) <= callable(getattr(system, "mass_matrix", None))


STARTS = [*((name, {}) for name in list_problems()), *CHANGED.items(), *FURTHER]
ROUNDOFF = {"heavy_top": 1e-14, "jay_negrut_pendulum": 1e-14, "slider_crank_flexible": 1.5e-13}  # velocities up to 150


@pytest.mark.parametrize(("name", "parameters"), STARTS)
def test_start_is_consistent_on_both_levels(make, name, parameters):
    problem = make(name, **parameters)
    system, start = Mechanics(compiled(problem.system)), (problem.t_span[0], problem.q0, problem.v0)
    np.testing.assert_allclose(system.g(*start[:2]), 0.0, rtol=0, atol=1e-15)
    for rows in (system.position_rate(*start), system.k(*start)):
        np.testing.assert_allclose(rows, 0.0, rtol=0, atol=ROUNDOFF.get(name, 2e-15))


@every_problem
def test_sketch_gives_finite_points_and_straight_pieces_and_moves(name):
    problem = default(name)
    drawing = problem.sketch(problem.q0)
    points, lines = drawing["points"], drawing["lines"]
    assert points.ndim == 2
    assert points.shape[1] in (2, 3)
    assert lines.shape[1:] == (2, points.shape[1])
    assert len(lines) > 0
    assert np.isfinite(points).all()
    assert np.isfinite(lines).all()
    moved = problem.sketch(problem.q0 + 0.1 * np.asarray(problem.scales.q))
    assert any(not np.array_equal(moved[key], drawing[key]) for key in drawing)


@every_problem
def test_scales_are_positive_and_fit_the_quantities(name):
    problem = default(name)
    system, start = Mechanics(compiled(problem.system)), _start(problem)
    m, p = np.size(system.g(*start[:2])), np.size(system.k(*start))
    for key, size in {"q": problem.q0.size, "v": problem.q0.size, "lam": m, "mu": p}.items():
        scale = np.asarray(getattr(problem.scales, key))
        assert np.all(scale > 0)
        assert np.all(np.isfinite(scale))
        assert scale.shape in ((), (size,))


@every_problem
def test_measurements_are_finite_and_travel_between_processes(name):
    problem = default(name)
    m = np.size(Mechanics(compiled(problem.system)).g(*_start(problem)[:2]))
    sent = pickle.loads(pickle.dumps((problem.sketch, dict(problem.observables), problem.exact)))
    sketch, observables, exact = sent
    np.testing.assert_array_equal(sketch(problem.q0)["lines"], problem.sketch(problem.q0)["lines"])
    assert observables.keys() == problem.observables.keys()
    for function in observables.values():
        assert np.isfinite(function(*_start(problem), np.zeros(m))).all()
    assert (exact is None) == (problem.exact is None)
    if exact is not None:
        t = sum(problem.t_span) / 2
        for own, other in zip(problem.exact(t), exact(t), strict=True):
            np.testing.assert_array_equal(other, own)


@pytest.mark.parametrize("name", CHANGED)
def test_new_parameter_values_change_arrays_alone(make, name):
    """A jitted function is called with the same structure, and traces no second time."""
    one, other = (make(name, **parameters).system for parameters in ({}, CHANGED[name]))
    assert eqx.tree_equal(*(eqx.filter(system, eqx.is_array, inverse=True) for system in (one, other)))
    first, second = jax.tree.leaves(one), jax.tree.leaves(other)
    assert all(isinstance(leaf, jax.Array) and leaf.dtype == np.float64 for leaf in first)
    assert [leaf.shape for leaf in first] == [leaf.shape for leaf in second]
    assert any(not np.array_equal(a, b) for a, b in zip(first, second, strict=True))


@pytest.mark.parametrize("name", [x if x in ("heavy_top", "knife_edge") else slow(x) for x in CHANGED])
def test_new_parameter_values_do_not_trace_again(make, name):
    traces = []

    @eqx.filter_jit
    def forces(system, t, q, v):
        traces.append(1)
        mass, g, k = (getattr(system, key, None) for key in ("mass_matrix", "constraint", "velocity_constraint"))
        mass = mass(t, q) if callable(mass) else mass
        return [system.force(t, q, v), mass, None if g is None else g(t, q), None if k is None else k(t, q, v)]

    problem, changed = make(name), make(name, **CHANGED[name])
    shift = 0.01 * np.arange(problem.q0.size) ** 2 / problem.q0.size
    first, second = (jax.tree.leaves(forces(p.system, 0.2, problem.q0 + shift, problem.v0 + 1)) for p in (problem, changed))
    assert len(traces) == 1
    assert any(not np.array_equal(a, b) for a, b in zip(first, second, strict=True))


def test_every_problem_with_parameters_is_among_the_changed_ones():
    assert set(list_problems()) - set(CHANGED) == {"jay_negrut_test1"}


@pytest.mark.parametrize(("name", "parameters"), [*CHANGED.items(), ("stiff_spring_pendulum", {"stiffness": 3e4})])
def test_changed_problem_has_neither_reference_nor_another_name(make, monkeypatch, name, parameters):
    module = importlib.import_module(f"problems.{name}")
    assert hasattr(module, "load_reference") or name == "oscillator_chain"
    monkeypatch.setattr(module, "load_reference", lambda stem, t_end: {"stem": stem}, raising=False)
    problem = make(name, **parameters)
    assert problem.reference is None
    assert problem.name == name
    assert (make(name).reference is None) == (name == "oscillator_chain")


ALONE = """
import json, sys
from hhtbench.catalogue.registry import list_problems, load_problem
imported = {}
for name in list_problems():
    for module in [module for module in sys.modules if module.partition(".")[0] == "problems"]:
        del sys.modules[module]
    load_problem(name)
    imported[name] = sorted(module for module in sys.modules if module.startswith("problems."))
print(json.dumps(imported))
"""


def test_loading_one_problem_imports_no_other():
    """Beside itself only what begins with an underscore."""
    out = subprocess.run([sys.executable, "-c", ALONE], capture_output=True, text=True, check=True).stdout
    imported = json.loads(out)
    assert imported.keys() == set(list_problems())
    others = {name: [m for m in modules if not m.startswith("problems._")] for name, modules in imported.items()}
    assert others == {name: [f"problems.{name}"] for name in list_problems()}
