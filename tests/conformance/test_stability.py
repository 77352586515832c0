"""The study of stability: expectations that hold by themselves, ends in their right class, nothing that hangs."""

from __future__ import annotations

import json
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from hhtbench.conformance.stability.closed_forms import FORMS, measure_closed_forms
from hhtbench.conformance.stability.newton import efforts
from hhtbench.conformance.stability.tables import STEP, allowed, markdown
from hhtbench.studies.acceptance.method import MATRIX

from hhtbench import api, processes
from hhtbench.conformance import Kind as CheckKind
from hhtbench.conformance import check_solver
from hhtbench.conformance.cell import Kind, Outcome, measure
from hhtbench.conformance.families import AXES, chosen_axes, linkages, modes, recurrence, scenes, servos
from hhtbench.conformance.families.quaternions import turning
from hhtbench.conformance.stability import study, workers
from hhtbench.conformance.stability.page import stability_page, write_stability
from hhtbench.conformance.stability.study import Stability, letters, study_stability
from hhtbench.conformance.stability.workers import Batch, Measured, outcome_in
from hhtbench.report import STABILITY
from hhtbench.report.atlas import failure_atlas
from hhtbench.store.rows import RunRow
from solvers.hht.verify.damping import roots
from tests.studies.liars import (
    Across,
    Beside,
    Deaf,
    Drifting,
    Exact,
    FirstOrder,
    Growing,
    Ignoring,
    Losing,
    OutOfPhase,
    Powerless,
    Raising,
    Shaking,
    Still,
    Straight,
)

LIARS = Path(__file__).with_name("liars.py")


def small(axis, solver="hht"):
    (found,) = chosen_axes([axis])
    return [cell for cell in found.cells() if cell.small and cell.is_about(solver)]


@pytest.mark.parametrize("alpha", [0.0, -0.15, -0.3])
@pytest.mark.parametrize("frequency", [0.1, 1.0, 10.0])
def test_the_closed_recurrence_has_the_roots_of_the_integrator_s_theory(alpha, frequency):
    ours = np.linalg.eigvals(recurrence.of_alpha(alpha).matrix(frequency))
    assert np.sort(np.abs(ours)) == pytest.approx(np.sort(np.abs(roots(alpha, frequency))), abs=1e-7)


def test_leapfrog_is_bounded_up_to_a_frequency_of_two_and_no_further():
    radius = [np.abs(np.linalg.eigvals(recurrence.LEAPFROG.matrix(x))).max() for x in (0.5, 1.9, 2.1)]
    assert radius[:2] == pytest.approx([1.0, 1.0]) and radius[2] > 1.2


@pytest.mark.parametrize("rho", [0.0, 0.5, 1.0])
def test_generalised_alpha_leaves_what_it_says_of_the_fastest_vibration(rho):
    assert np.abs(np.linalg.eigvals(recurrence.of_rho(rho).matrix(1e4))).max() == pytest.approx(rho, abs=0.02)


CLOSED = {
    "stiff": lambda: scenes.stiff(100.0, 2.0),
    "damped": lambda: scenes.damped(50.0, 2.0),
    "led": lambda: scenes.led(100.0, 10.0, 2.0),
    "hung": lambda: servos.hung(100.0, 10.0, 2.0),
    "spinning": lambda: scenes.spinning(20.0, 2.0),
    "pushed": lambda: scenes.pushed(3.0, 0.7, 2.0),
    "bouncing": lambda: scenes.bouncing(100.0, 2.0),
    "sliding": lambda: scenes.sliding(0.2, 2.0),
    "leaning": lambda: scenes.leaning([[1.0, 0.0], [1.0, 0.1]], 2.0),
    "parallelogram": lambda: linkages.parallelogram(2.0),
    "turning": lambda: turning(3.0, 1e-2),
    "guided": lambda: modes.guided(0.2),
}


@pytest.mark.parametrize("name", CLOSED)
def test_closed_solutions_satisfy_the_equations_of_motion(name):
    problem, h = CLOSED[name](), 1e-4
    system = problem.system
    for t in np.linspace(0.05, 1.95, 12):
        before, now, after = (problem.exact(t + s) for s in (-h, 0.0, h))
        acceleration = (after.v - before.v) / (2 * h)
        assert (after.q - before.q) / (2 * h) == pytest.approx(now.v, abs=1e-5)
        rows = np.array([np.asarray(system.constraint(t, now.q + d)) for d in 1e-6 * np.eye(now.q.size)])
        rows = ((rows - np.asarray(system.constraint(t, now.q))) / 1e-6).T
        mass = np.asarray(system.mass_matrix(t, now.q)) if hasattr(system, "mass_matrix") else np.eye(now.q.size)
        unbalanced = mass @ acceleration - np.asarray(system.force(t, now.q, now.v))
        reaction = rows.T @ np.linalg.lstsq(rows.T, unbalanced, rcond=None)[0]
        assert unbalanced == pytest.approx(reaction, abs=1e-4)
        assert np.isnan(now.lam).all() or unbalanced == pytest.approx(-rows.T @ now.lam, abs=1e-4)
        assert np.asarray(system.constraint(t, now.q)) == pytest.approx(0.0, abs=1e-12)


def test_the_speed_of_a_sliding_mass_obeys_its_friction():
    width, h = 0.05, 1e-5
    for t in (0.1, 0.9, 1.0, 1.1):
        rate = (scenes.sliding_speed(width, t + h) - scenes.sliding_speed(width, t - h)) / (2 * h)
        assert rate == pytest.approx(-np.tanh(scenes.sliding_speed(width, t) / width), abs=1e-6)


@pytest.mark.parametrize("axis", ["stiffness", "wrong_a0"])
def test_hht_is_right_or_says_why_not(axis):
    found = [measure(cell, "hht").kind for cell in small(axis)]
    assert found and set(found) <= {Kind.right, Kind.budget}


def test_a_line_tells_what_is_allowed():
    found = told()
    assert allowed(found, found.axes[0])["rtol 1e-05"].startswith("slow motion 0.001; ")


EVERYWHERE = (0.0, np.inf)
TURNS = {"steps": (1e-3, 1.0), "span": (1.0, 1e3)}  # beyond these nothing turns


def of_liar(axis, liar, cells=None):
    """How it ends in the small cells, those of other families too, where ``hb.solve`` believes it."""
    (found,) = chosen_axes([axis])
    low, high = TURNS.get(axis, EVERYWHERE)
    chosen = [cell for cell in found.cells() if (cell.small if cells is None else cells(cell)) and low <= cell.x <= high]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(api, "check_success", lambda *_: "")
        return [measure(replace(cell, families=(), options={}), liar).kind for cell in chosen]


def is_told(axis, liar, cells=None):
    kinds = of_liar(axis, liar, cells)
    return bool(kinds) and set(kinds) == {Kind.wrong}


@pytest.mark.parametrize("axis", [x.name for x in AXES])
def test_a_motion_straight_on_is_nowhere_right_where_the_motion_turns(axis):
    assert is_told(axis, Straight())


HELD = (
    "stiffness",
    "dampers",
    "servo",
    "spin",
    "quaternions",
    "steps",
    "rank",
    "redundant",
    "jump",
    "wrong_a0",
    "friction",
    "contact",
)


@pytest.mark.parametrize("axis", HELD)
def test_a_solver_that_ignores_constraints_is_nowhere_right(axis):
    assert is_told(axis, Ignoring())


@pytest.mark.parametrize("axis", [name for name in HELD if name not in ("contact", "jump")])
def test_constraints_that_take_up_no_force_are_nowhere_right(axis):
    assert is_told(axis, Powerless())


def at(*values):
    return lambda cell: cell.x in values


def by_steps(cell):
    return "rtol" not in cell.request


LIES = (
    ("rank", Across, None),
    ("redundant", Across, None),
    ("tension", Still, None),
    ("order", Still, lambda cell: "fitted" not in cell.line),
    ("order", FirstOrder, lambda cell: "fitted" in cell.line),
    ("span", OutOfPhase, at(1e3)),
    ("jump", Deaf, None),
    ("jump", Deaf, at(1e-2)),
    ("wrong_a0", Deaf, at(1e-2)),
    ("dead_points", Beside, lambda cell: "slider" in cell.line),
    ("perturbations", Growing, None),
    ("ratios", Shaking, lambda cell: "stiff" in cell.line),
    ("long_run", Drifting, lambda cell: cell.small and by_steps(cell)),
    ("long_run", Losing, lambda cell: cell.small and by_steps(cell) and "pendulum" in cell.line),
)


@pytest.mark.parametrize(("axis", "liar", "cells"), LIES)
def test_what_an_axis_is_named_after_is_measured(axis, liar, cells):
    assert is_told(axis, liar(), cells)


@pytest.mark.parametrize("solver", ["hht", "hht(alpha=-0.3)"])
def test_extrapolated_multipliers_pass_over_a_vibration_that_the_tension_carries(solver):
    """All along the axis, where b = 0 is right up to h omega = 1.9 alone."""
    cells = [cell for cell in chosen_axes(["tension"])[0].cells() if cell.line == "h = 0.01 s, extrapolated"]
    assert [measure(cell, solver).kind for cell in cells] == [Kind.right] * 8
    assert measure(cells[-1], "hht(alpha=0)").kind is Kind.declined
    assert not cells[0].is_about("rattle")


@pytest.mark.parametrize("axis", ["stiffness", "rank", "friction", "span", "jump", "dead_points", "quaternions"])
def test_the_closed_solution_is_right_everywhere(axis):
    kinds = of_liar(axis, Exact(), lambda cell: not (axis == "dead_points" and "slider" not in cell.line))
    assert kinds and set(kinds) == {Kind.right}


@pytest.mark.parametrize(
    ("solver", "line", "other"),
    [("hht", "force", {"alpha": -0.2}), ("generalised_alpha", "velocity", {"rho_inf": 0.7, "form": "index3"})],
)
def test_multipliers_find_back_as_the_closed_recurrence_of_the_method_says_and_of_no_other(solver, line, other):
    cells = small("multiplier_modes", solver)
    assert {measure(cell, solver).kind for cell in cells} == {Kind.right}
    (cell,) = [cell for cell in cells if cell.line.startswith(line)]
    found = measure(replace(cell, options={**cell.options, **other}), solver)
    assert found.kind is Kind.wrong and found.errors["multipliers"] > 0.01


def test_a_larger_error_is_told_only_where_the_message_names_its_cause():
    (cell,) = [x for x in chosen_axes(["contact"])[0].cells() if x.line == "h = 0.001 s" and x.x == 1e10]
    assert measure(cell, "hht").kind is Kind.told
    assert measure(replace(cell, cause="of another kind"), "hht").kind is Kind.wrong
    assert measure(replace(cell, cause=""), "hht").kind is Kind.wrong
    assert not Kind.told.misleading


def test_an_exception_is_a_crash():
    found = measure(small("stiffness")[0], Raising())
    assert found.kind is Kind.crashed and "ArithmeticError: lost" in found.message


def test_a_solver_that_hangs_or_dies_costs_one_cell(monkeypatch):
    worker = processes.Worker()
    try:
        for name, words, overdue in (("Sleeping", "killed", 4.0), ("Dying", "ended: exit code 7", 100.0)):
            monkeypatch.setattr(workers, "OVERDUE", overdue)
            found = outcome_in(worker, Batch(f"{LIARS}:{name}", "stiffness", 0, (0,)), 0, 0.0)
            assert found.kind is Kind.crashed and words in found.message
    finally:
        worker.end()


def outcome(kind, **more):
    return Outcome(kind=kind, status="success", message="", **more)


def told():
    (axis,) = chosen_axes(["stiffness"])
    kinds = {
        "good": (Kind.right, Kind.right),
        "named": (Kind.named, Kind.named),
        "late": (Kind.budget, Kind.budget),
        "bad": (Kind.right, Kind.wrong),
        "shy": (Kind.declined, Kind.declined),
    }
    measured = [
        Measured(solver, "stiffness", x, "h = 1 s", outcome(kind, share=0.5, seconds=x / 1e4))
        for solver, pair in kinds.items()
        for x, kind in zip((1e2, 1e4), pair, strict=True)
    ]
    return Stability(axes=(axis,), solvers=tuple(kinds), seed=0, measured=tuple(measured), seconds=1.0)


def test_a_sentence_says_where_a_solver_is_safe():
    found = told()
    assert found.sentence("good").endswith("Safe on stiffness.")
    assert found.sentence("bad").endswith("Safe on no whole axis. Misleading on stiffness (1 of 2, at 10000).")
    assert found.sentence("named").startswith("named: of 2 cells 2 ended early and said so within 1 s.")
    for never in ("named", "late"):
        assert found.sentence(never).endswith(
            "Safe on no whole axis. Never misleading, but seldom arriving, on stiffness (0 right of 2)."
        )
    assert found.sentence("shy") == "shy can be asked none of these."
    assert letters(found.measured)["bad"] == {"h = 1 s": "rW"}


def counted(axis, x, line, iterations, accepted, rejected):
    steps = {"newton_iterations": iterations, "steps": accepted, "attempts": accepted + rejected}
    return Measured("hht", axis, x, line, outcome(Kind.right, **steps))


def test_iterations_a_step_are_told_of_steps_tried_and_accepted_beside_the_figure():
    measured = (
        counted("order", 1e10, "rtol 0.001", 1000, 88, 84),
        counted("stiffness", 1e4, "rtol 0.001", 300, 100, 0),
        counted("masses", 1e8, "rtol 0.0001", 9000, 10, 0),
        counted("masses", 1e-8, "h = 0.001 s", 700, 100, 0),
        counted("spin", 1.0, "rtol 0.001", 9000, 10, 0),
    )
    axes = chosen_axes(["order", "stiffness", "masses"])
    found = Stability(axes=axes, solvers=("hht",), seed=0, measured=measured, seconds=1.0)
    tried, accepted, above, _, fixed, _ = efforts(found)
    assert tried.worst == 1000 / 172 and tried.mean == 1300 / 272 and tried.verdict == "met"
    assert accepted.worst == 1000 / 88 and accepted.verdict == "missed" and "order 1e+10, rtol 0.001" in str(accepted)
    assert above.light_above and above.verdict == "no figure"
    assert fixed.asked == "h = 0.001 s" and fixed.verdict == "missed"
    assert "| 11.36" in markdown(found)


def test_text_page_and_numbers_hold_every_cell(tmp_path):
    found = told()
    assert "| bad" in markdown(found) and "rW" in markdown(found)
    page = write_stability(found, tmp_path)
    assert page.name == STABILITY and "silently wrong" in page.read_text(encoding="utf-8")
    cells = json.loads(json.dumps(found.as_dict()))["cells"]
    assert [cell["kind"] for cell in cells] == [x.outcome.kind.label for x in found.measured]


def test_text_and_page_show_the_step_of_hht_against_closed_forms():
    found = replace(told(), closed_forms=measure_closed_forms())
    assert all(x < MATRIX for x in found.closed_forms.errors.values())  # none is NaN
    assert len(found.closed_forms.outcomes) == len(FORMS)
    assert json.loads(json.dumps(found.as_dict()))["closed_forms"]["forms"][0]["verdict"] == "holds"
    for text in (markdown(found), stability_page(found)):
        assert STEP in unescape(text) and "w h = 1e+08" in text and "off the series by" in text


@pytest.mark.parametrize(("only", "solvers", "there"), [((), ("ida", "hht(alpha=-0.3)"), True), (("span",), (), False)])
def test_the_step_of_hht_is_part_of_a_study_of_all_axes(only, solvers, there, monkeypatch):
    monkeypatch.setattr(study, "measure_all", lambda *_: [])
    assert (study_stability(only, solvers).closed_forms is not None) == there


def test_a_study_without_hht_has_no_step_of_it(monkeypatch):
    monkeypatch.setattr(study, "measure_all", lambda *_: [])
    found = study_stability((), ("ida",))
    assert found.closed_forms is None and STEP not in unescape(stability_page(found))


def test_the_study_measures_every_small_cell_in_its_workers():
    found = study_stability(["redundant"], ["hht"], jobs=1, small=True)
    assert [x.outcome.kind for x in found.measured] == [Kind.right] * len(small("redundant"))


def test_others_solvers_are_checked_by_the_same_cells(monkeypatch):
    checks = {check.name: check for check in check_solver("hht", suite="extremes")}
    assert len(checks) == sum(cell.small for axis in AXES for cell in axis.cells()) and len({*checks}) > 60
    assert checks["rank/h = 0.01 s/0.0001"].run().kind is CheckKind.passed
    monkeypatch.setattr(api, "check_success", lambda *_: "")
    straight = {check.name: check for check in check_solver(f"{LIARS}:Straight", suite="extremes")}
    assert straight["ratios/1 : r, stiff/100"].run().message.startswith("success, but ")
    assert straight["amplification/leapfrog/0.1"].run().message == "it is about rattle."
    with pytest.raises(ValueError, match="claims or extremes"):
        check_solver("hht", suite="extreme")


def row(solver, status, rtol=1e-6, message="", error=None):
    errors = {} if error is None else {"errors": {"q": {"max_scaled": error}}}
    request = {"rtol": rtol, "atol": None, "step": None, "steps": None}
    return RunRow(key=solver, problem="p", solver=solver, request=request, status=status, message=message, metrics=errors)


def test_the_atlas_types_every_failure():
    rows = [
        row("ida(form='ggl')", "success", error=9e-4),
        row("ida(form='index2')", "success", error=2e-3),
        row("ida(form='ggl')", "newton_failed", 3e-6, "at t = 1"),
        row("hht", "unreliable", message="constraints: violated"),
        row("rattle", "declined"),
    ]
    found = failure_atlas(rows)
    assert found.runs == 4
    assert {(x.solver, x.form, x.accuracy, x.cause) for x in found.failures} == {
        ("ida", "index2", "rtol 1e-6", "silently wrong"),
        ("ida", "ggl", "rtol 1e-6", "newton_failed"),
        ("hht", "", "rtol 1e-6", "unreliable: constraints"),
    }
    assert found.table().rows[0][4].text == "silently wrong"
    assert "3 of 4 runs failed" in found.causes().note
