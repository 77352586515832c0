"""The stored references: complete, certified, accurate enough, given by their problems, true where that is known."""

import importlib
import json

import numpy as np
import pytest

from hhtbench.campaign.reference.plan import load_plan
from hhtbench.catalogue.registry import list_problems, load_problem
from hhtbench.catalogue.specs import parse_spec
from problems import _common

PLAN = load_plan(_common.REFERENCES / "plan.toml")
ENOUGH = {"q": 1e-11, "v": 1e-11, "lam": 1e-9, "mu": 1e-9}  # largest scaled bars at the stated times
FEWER = {  # entries whose note says why they have fewer digits: what they must hold all the same
    "andrews": {"v": 3e-11},
    "cable_pendulum_2d": {"v": 3e-10},
    "cable_pendulum_3d": {"v": 3e-10},
    "ball_mill": {"q": 2e-10, "v": 2e-10},
    "band_track": {"q": 5e-10, "v": 5e-9, "lam": 2e-8},
    "belt_drive": {"v": 5e-9},
    "bushing_chain_c3e3": {"v": 1e-10},
    "bushing_chain_c3e6": {"q": 5e-9, "v": 2e-8},
    "cam_follower": {"q": 2e-9, "v": 2e-8, "lam": 5e-7},
    "flexible_crank": {"v": 3e-10, "lam": 2e-8},
    "flyball_governor": {"q": 5e-8, "v": 5e-8, "lam": 2e-8},
    "heavy_top": {"q": 2e-11, "v": 2e-11},
    "hf_linear_constrained_k1e8": {"v": 5e-11},
    "mooring_line": {"q": 1e-10, "v": 3e-9},
    "right_angle_cantilever": {"v": 1e-10, "lam": 5e-9},
    "slider_crank_flexible": {"q": 2e-10, "v": 2e-10},
    "spinup_beam": {"q": 2e-9, "v": 2e-7, "lam": 3e-8},
    "stiff_spring_pendulum_k1e8": {"v": 1e-10, "lam": 2e-7},
    "train_buffers": {"q": 3e-11, "v": 1e-10},
}
EPS = float(np.finfo(np.float64).eps)
FILES = sorted(file.stem for file in _common.REFERENCES.glob("*.json"))
entries = pytest.mark.parametrize("name", [name for name in FILES if name in PLAN])


def stored(name):
    return json.loads((_common.REFERENCES / f"{name}.json").read_text(encoding="utf-8"))


def test_every_problem_has_a_certified_reference_or_a_closed_solution():
    planned = {entry.spec.partition("(")[0] for entry in PLAN.values()}
    assert planned <= set(list_problems())
    without = [name for name in list_problems() if name not in planned and load_problem(name).exact is None]
    assert not without


def test_every_planned_reference_is_stored_and_no_other():
    assert sorted(PLAN) == FILES


@entries
def test_reference_was_computed_as_planned_and_confirmed_by_another_family_on_another_form(name):
    reference, entry = stored(name), PLAN[name]
    assert (reference["spec"], reference["stated"], reference["note"]) == (entry.spec, list(entry.times), entry.note)
    assert (reference["first"], reference["rtol"]) == (entry.first, entry.rtol)
    assert [other["solver"] for other in reference["confirmed_by"]][: len(entry.second)] == list(entry.second)
    assert set(entry.times) <= set(reference["t"])
    assert any(other["independent"] and other["status"] == "success" for other in reference["confirmed_by"])


@entries
def test_reference_has_eleven_digits_in_q_and_v_and_nine_in_the_multipliers_or_says_why_not(name):
    reference = stored(name)
    rows = [reference["t"].index(t) for t in reference["stated"]]
    bars = {key: max(reference["bars"][key][i] for i in rows) for key in ENOUGH if key in reference["bars"]}
    assert {"q", "v"} <= bars.keys()
    assert np.isfinite(list(bars.values())).all(), bars
    limits = ENOUGH | FEWER.get(name, {})
    assert all(bar <= limits[key] for key, bar in bars.items()), bars
    assert len(reference["note"]) > 20 or name not in FEWER, "a note must say why"


@entries
def test_error_bars_cover_every_row_and_never_shrink(name):
    reference = stored(name)
    assert np.all(np.diff(reference["t"]) > 0)
    assert reference["bars"].keys() == reference["values"].keys() == reference["scales"].keys()
    for key, bars in reference["bars"].items():
        assert len(bars) == len(reference["values"][key]) == len(reference["t"])
        assert np.all(np.diff(bars) >= 0)
        assert min(bars) >= 4 * EPS
        assert min(reference["scales"][key]) > 0


@entries
def test_problem_gives_its_reference(name):
    reference, problem = stored(name), load_problem(PLAN[name].spec)
    given = problem.reference
    assert given is not None
    np.testing.assert_array_equal(given["t"], reference["t"])
    np.testing.assert_array_equal(given["q"], reference["values"]["q"])
    shapes = {key: (len(reference["t"]), problem.q0.size) for key in ("q", "v")}
    assert {key: given[key].shape for key in shapes} == shapes


@entries
def test_reference_lies_within_its_bars_of_the_closed_solution(name):
    """Roundoff of the closed solution apart: some units in the last place of the largest entry, or of the angles it uses."""
    reference, problem = stored(name), load_problem(PLAN[name].spec)
    if problem.exact is None:
        pytest.skip("no closed solution is known")
    motions = [problem.exact(t) for t in reference["t"]]
    for key in ENOUGH.keys() & reference["values"].keys():
        exact = np.array([getattr(motion, key) for motion in motions])
        off = np.max(np.abs(exact - reference["values"][key]) / reference["scales"][key], axis=1)
        bars = np.array(reference["bars"][key])
        i = int(np.argmax(off / (bars + 16 * EPS)))
        assert off[i] <= bars[i] + 16 * EPS, f"{key} at {reference['t'][i]} s: {off[i]:.3e} against a bar of {bars[i]:.1e}"


@entries
def test_problem_asks_for_the_reference_of_its_parameters_up_to_its_end(monkeypatch, name):
    """Also where another problem file would give values of the same shape."""
    spec = parse_spec(PLAN[name].spec)
    module = importlib.import_module(f"problems.{spec.name}")
    monkeypatch.setattr(module, "load_reference", lambda stem, t_end: {"stem": stem, "t_end": t_end})
    arguments = {key: value for key, value in spec.arguments.items() if key != "t_end"}
    t_end = load_problem(PLAN[name].spec).t_span[0] + 0.05
    assert load_problem(spec.name, **arguments, t_end=t_end).reference == {"stem": name, "t_end": t_end}
