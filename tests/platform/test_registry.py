from __future__ import annotations

import importlib
import json
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import pytest

from hhtbench.catalogue.registry import (
    list_problems,
    list_solvers,
    list_verifications,
    load_problem,
    load_solver,
    load_verification,
)
from hhtbench.protocol.errors import NotFoundError, ProblemError
from hhtbench.protocol.problem import Problem
from tests.platform.plugins_fixture import PROBLEM, forget, make_distribution


def test_third_party_distribution_plugs_in_by_entry_points(acme):
    assert {"acme_fall", "acme_slide"} <= set(list_problems())
    assert "acme_still" in list_solvers()
    assert {"acme_good", "acme_bad"} <= set(list_verifications())
    assert list_problems() == sorted(list_problems())
    assert load_problem("acme_fall(height=3)").q0[0] == 3.0
    assert load_solver("acme_still(alpha=-0.1)").alpha == -0.1
    assert load_verification("acme_good")(None).passed


def test_loading_one_problem_imports_no_other(acme):
    load_problem("acme_fall")
    assert "acme_plugin.fall" in sys.modules
    assert not {"acme_plugin.slide", "acme_plugin.still", "acme_plugin.good"} & set(sys.modules)


def test_listing_imports_nothing(acme):
    list_problems()
    assert "acme_plugin" not in sys.modules


def test_objects_pass_unchanged_and_take_no_parameters(acme):
    problem = load_problem("acme_fall")
    assert load_problem(problem) is problem
    with pytest.raises(ProblemError, match="fall is no function and takes no parameters; got height"):
        load_problem(problem, height=2)
    solver = load_solver("acme_still")
    assert load_solver(solver) is solver
    with pytest.raises(TypeError, match="have accepts"):
        load_solver(3)
    with pytest.raises(TypeError, match="a spec must be a string"):
        load_problem(3)


def test_keywords_add_to_the_spec_but_do_not_contradict_it(acme):
    assert load_problem("acme_fall(n=2)", height=5.0).q0.tolist() == [5.0, 5.0]
    with pytest.raises(ProblemError, match="height is given in the spec"):
        load_problem("acme_fall(height=1)", height=1)


def test_unknown_name_is_answered_with_the_closest_and_how_to_list(acme):
    with pytest.raises(NotFoundError, match=r"no problem named 'acme_fal'.*Did you mean acme_fall\?.*hhtbench list"):
        load_problem("acme_fal")
    with pytest.raises(NotFoundError, match=r"no solver named 'acme_stil'.*acme_still"):
        load_solver("acme_stil")
    with pytest.raises(LookupError, match="no verification named 'qqqq'"):
        load_verification("qqqq")


def test_unknown_parameter_is_answered_with_the_known_ones(acme):
    with pytest.raises(ProblemError, match=r"Did you mean height\? Known parameters: height=1.0, n=1"):
        load_problem("acme_fall(heigth=1)")


def test_type_error_from_inside_a_factory_is_not_taken_for_an_unknown_parameter(mechanism):
    with pytest.raises(TypeError, match="has no len"):
        load_problem("my_mechanism.py:breaks_inside")


def test_what_is_no_problem_is_refused(acme):
    with pytest.raises(ProblemError, match=r"acme_nonsense must be a hhtbench.Problem or return one; got int"):
        load_problem("acme_nonsense")
    with pytest.raises(ProblemError, match="no attribute 'absent'"):
        load_problem("acme_missing")


def test_failing_import_names_the_library_and_the_file_found(acme):
    with pytest.raises(ProblemError, match=r"acme 1.0.*a_library_that_is_missing.*found acme_plugin at") as caught:
        load_problem("acme_broken")
    assert str(acme / "acme_plugin") in str(caught.value)


def test_two_plugins_of_one_name_are_an_error_that_names_both(acme, tmp_path, monkeypatch):
    groups = {"hhtbench.problems": {"acme_fall": "rival_plugin:problem"}}
    rival = make_distribution(tmp_path / "rival", "rival", {"rival_plugin.py": PROBLEM}, groups)
    monkeypatch.syspath_prepend(str(rival))
    with pytest.raises(ProblemError, match=r"acme 1.0 \(acme_plugin.fall:problem\) and rival 1.0 \(rival_plugin:problem\)"):
        load_problem("acme_fall")
    assert list_problems().count("acme_fall") == 1


@pytest.mark.parametrize("shadow", ["acme_plugin.py", "acme_plugin/fall.py"])
def test_users_file_that_hides_a_plugin_is_named_and_not_executed(shadow, acme, tmp_path, monkeypatch):
    own = tmp_path / "own" / shadow
    own.parent.mkdir(parents=True)
    own.write_text("raise SystemExit('executed')\n", encoding="utf-8")
    if shadow == "acme_plugin/fall.py":
        (own.parent / "__init__.py").write_text("", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path / "own"))
    with pytest.raises(ProblemError, match=r"acme 1.0 means its own acme_plugin.fall, but Python finds") as caught:
        load_problem("acme_fall")
    assert str(tmp_path / "own" / "acme_plugin") in str(caught.value)


@pytest.mark.parametrize("first", ["ours", "theirs"])
@pytest.mark.parametrize("installed", ["copied", "editable"])
def test_a_users_folder_of_a_plugins_name_is_no_obstacle_to_either(first, installed, acme, tmp_path, monkeypatch):
    own = tmp_path / "own" / "acme_plugin"
    own.mkdir(parents=True)
    (own / "mine.py").write_text("VALUE = 7\n", encoding="utf-8")
    if installed == "editable":  # Python finds even a folder without __init__.py before such a distribution
        project = tmp_path / "project"
        project.mkdir()
        (acme / "acme_plugin").rename(project / "acme_plugin")
        origin = {"url": project.as_uri(), "dir_info": {"editable": True}}
        (acme / "acme-1.0.dist-info" / "direct_url.json").write_text(json.dumps(origin))
    else:
        (own / "__init__.py").write_text("", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path / "own"))
    if first == "theirs":
        assert importlib.import_module("acme_plugin.mine").VALUE == 7
    for _ in range(2):
        assert load_problem("acme_fall").q0.size == 1
        assert importlib.import_module("acme_plugin.mine").VALUE == 7
    assert "acme_fall" in list_problems()


def test_shadow_that_is_imported_already_is_found_too(acme, tmp_path, monkeypatch):
    own = tmp_path / "own"
    own.mkdir()
    (own / "acme_plugin.py").write_text("", encoding="utf-8")
    with monkeypatch.context() as patch:
        patch.syspath_prepend(str(own))
        __import__("acme_plugin")
    with pytest.raises(ProblemError, match=r"Python finds .*own"):
        load_problem("acme_fall")


def test_file_is_executed_from_its_path(mechanism):
    assert load_problem("my_mechanism.py:problem(height=7)").q0[0] == 7.0
    assert load_problem(f"{mechanism}/my_mechanism.py:problem", n=2).q0.size == 2
    assert isinstance(load_problem("my_mechanism.py:finished"), Problem)
    assert "my_mechanism" not in sys.modules


def test_same_file_keeps_its_classes_and_changed_file_is_read_again(mechanism):
    first, again = load_problem("my_mechanism.py:problem"), load_problem("my_mechanism.py:problem")
    assert again.system is first.system  # what was derived from it serves again
    file = mechanism / "my_mechanism.py"
    file.write_text(file.read_text().replace("height=1.0", "height=2.0"))
    assert load_problem("my_mechanism.py:problem").q0[0] == 2.0


READS = """\
import hhtbench as hb

class Spring(hb.System):
    k: object = hb.parameter()

    def force(self, t, q, v):
        return -self.k * q

def problem():
    spring = Spring(k=float(open("k.txt").read()))
    return hb.Problem(name="spring", system=spring, t_span=(0.0, 1.0), q0=[1.0], v0=[0.0])
"""


def test_a_system_is_kept_only_while_its_values_are_the_same(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "reads.py").write_text(READS)
    systems = []
    for value in ("2.0", "2.0", "3.0", "0.0", "-0.0"):
        (tmp_path / "k.txt").write_text(value)
        systems.append(load_problem("reads.py:problem").system)
    assert [one is other for one, other in pairwise(systems)] == [True, False, False, False]
    assert float(systems[2].k) == 3.0


def test_systems_are_kept_by_threads_too(monkeypatch):
    monkeypatch.setattr("hhtbench.catalogue.registry.MAX_SYSTEMS", 2)
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(6) as pool:
            lengths = [1.0 + k / 8 for k in range(8)] * 40
            found = list(pool.map(lambda length: load_problem(f"simple_pendulum(L={length})"), lengths))
    finally:
        sys.setswitchinterval(interval)
    assert [float(problem.system.L) for problem in found] == lengths


def test_file_may_import_its_neighbour_but_leaves_the_path_as_it_was(mechanism):
    (mechanism / "my_neighbour.py").write_text("height = 4.0\n")
    file = mechanism / "my_mechanism.py"
    file.write_text(f"import my_neighbour\n{file.read_text()}\nnear = problem(my_neighbour.height)\n")
    before = list(sys.path)
    assert load_problem("my_mechanism.py:near").q0[0] == 4.0
    assert sys.path == before
    forget("my_neighbour")


@pytest.mark.parametrize(
    ("spec", "reason"),
    [
        ("my_mechanisms.py:problem", "no file my_mechanisms.py .*did you mean my_mechanism.py"),
        ("elsewhere/x.py:problem", "no file elsewhere/x.py"),
        ("my_mechanism.py:problems", "no attribute problems; did you mean problem"),
        ("my_mechanism.py:zzz", "no attribute zzz; it defines Fall, problem, finished, makes_nonsense"),
        ("my_mechanism.py:nonsense", "must be a hhtbench.Problem or return one; got int"),
        ("my_mechanism.py:makes_nonsense(k=2.5)", "must be a hhtbench.Problem or return one; got float"),
        ("my_mechanism.py:finished(k=1)", "my_mechanism.py:finished is no function and takes no parameters; got k"),
        ("my_mechanism.py:problem(hight=1)", "Did you mean height"),
    ],
)
def test_wrong_use_of_a_file_is_explained(spec, reason, mechanism):
    with pytest.raises(ProblemError, match=reason):
        load_problem(spec)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("x = 1\nraise ValueError('on purpose')\n", "broken.py, line 2, raised ValueError: on purpose"),
        ("x = 1\ndef f(:\n", "broken.py, line 2, raised SyntaxError"),
        ("\n\nimport not_there_at_all\n", "broken.py, line 3, raised ModuleNotFoundError"),
    ],
)
def test_file_that_fails_names_its_own_line_and_is_not_kept(text, reason, mechanism):
    (mechanism / "broken.py").write_text(text)
    for _ in range(2):
        with pytest.raises(ProblemError, match=reason):
            load_problem("broken.py:problem")
    assert not [m for m in sys.modules.values() if str(getattr(m, "__file__", "")).endswith("broken.py")]
