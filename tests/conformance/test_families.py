"""Families of cells: closed solutions are solutions, and no solver that misleads is right in a cell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hhtbench import api
from hhtbench.conformance import check_solver
from hhtbench.conformance.entry import Kind
from hhtbench.conformance.families.quaternions import turning
from hhtbench.conformance.registry import FAMILIES, checks_of, chosen
from hhtbench.conformance.scenes import circles, servos
from hhtbench.conformance.subject import Subject
from tests.conformance.synthetic import (
    SYNTHETIC,
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
from tests.sample import slow


def of(name):
    (found,) = chosen(FAMILIES, [name], "axis")
    return found


def cells_of(name):
    return [cell for (cell,) in of(name).cases()]


def small(name, solver="hht"):
    return [cell for cell in cells_of(name) if cell.small and cell.is_about(solver)]


def run(name, cell, solver):
    return of(name).run(Subject(solver), cell)


CLOSED = {
    "stiff": lambda: circles.stiff(100.0, 2.0),
    "damped": lambda: circles.damped(50.0, 2.0),
    "led": lambda: circles.led(100.0, 10.0, 2.0),
    "hung": lambda: servos.hung(100.0, 10.0, 2.0),
    "spinning": lambda: circles.spinning(20.0, 2.0),
    "pushed": lambda: circles.pushed(3.0, 0.7, 2.0),
    "bouncing": lambda: circles.bouncing(100.0, 2.0),
    "sliding": lambda: circles.sliding(0.2, 2.0),
    "leaning": lambda: circles.leaning([[1.0, 0.0], [1.0, 0.1]], 2.0),
    "turning": lambda: turning(3.0, 1e-2),
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
        rate = (circles.sliding_speed(width, t + h) - circles.sliding_speed(width, t - h)) / (2 * h)
        assert rate == pytest.approx(-np.tanh(circles.sliding_speed(width, t) / width), abs=1e-6)


@pytest.mark.parametrize("axis", ["stiffness", "jump"])
def test_hht_is_right_or_says_why_not(axis):
    found = [run(axis, cell, "hht").kind for cell in small(axis)]
    assert found and set(found) <= {Kind.right, Kind.budget}


EVERYWHERE = (0.0, np.inf)
TURNS = {"steps": (1e-3, 1.0), "span": (1.0, 1e3)}  # beyond these nothing turns


def kinds_of(axis, solver, cells=None):
    """How it ends in the small cells, those of other solvers too, where ``hb.solve`` believes it."""
    low, high = TURNS.get(axis, EVERYWHERE)
    picked = [cell for cell in cells_of(axis) if (cell.small if cells is None else cells(cell)) and low <= cell.x <= high]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(api, "check_success", lambda *_: "")
        return [run(axis, replace(cell, families=(), options={}), solver).kind for cell in picked]


def is_found(axis, solver, cells=None):
    kinds = kinds_of(axis, solver, cells)
    return bool(kinds) and set(kinds) == {Kind.wrong}


@pytest.mark.parametrize("axis", [x.id for x in FAMILIES])
def test_a_motion_straight_on_is_nowhere_right_where_the_motion_turns(axis):
    assert is_found(axis, Straight())


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
    "friction",
    "contact",
)


@pytest.mark.parametrize("axis", [slow(x) if x in ("quaternions", "friction") else x for x in HELD])
def test_a_solver_that_ignores_constraints_is_nowhere_right(axis):
    assert is_found(axis, Ignoring())


@pytest.mark.parametrize("axis", [name for name in HELD if name not in ("contact", "jump")])
def test_constraints_that_take_up_no_force_are_nowhere_right(axis):
    assert is_found(axis, Powerless())


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
    ("dead_points", Beside, lambda cell: "slider" in cell.line),
    ("perturbations", Growing, None),
    ("ratios", Shaking, lambda cell: "stiff" in cell.line),
    ("long_run", Drifting, lambda cell: cell.small and by_steps(cell)),
    ("long_run", Losing, lambda cell: cell.small and by_steps(cell)),
)


@pytest.mark.parametrize(("axis", "solver", "cells"), LIES)
def test_what_an_axis_is_named_after_is_measured(axis, solver, cells):
    assert is_found(axis, solver(), cells)


@pytest.mark.parametrize("solver", ["hht", "hht(alpha=-0.3)"])
def test_extrapolated_multipliers_pass_over_a_vibration_that_the_tension_carries(solver):
    """All along the axis, where b = 0 is right up to h omega = 1.9 alone."""
    cells = [cell for cell in cells_of("tension") if cell.line == "h = 0.01 s, extrapolated"]
    assert [run("tension", cell, solver).kind for cell in cells] == [Kind.right] * 8
    assert run("tension", cells[-1], "hht(alpha=0)").kind is Kind.declined
    assert not cells[0].is_about("rattle")


@pytest.mark.parametrize("axis", ["stiffness", "rank", "friction", "span", "jump", "dead_points", slow("quaternions")])
def test_the_closed_solution_is_right_everywhere(axis):
    kinds = kinds_of(axis, Exact(), lambda cell: not (axis == "dead_points" and "slider" not in cell.line))
    assert kinds and set(kinds) == {Kind.right}


def test_a_larger_error_is_a_warning_only_where_the_message_names_its_cause():
    (cell,) = [x for x in cells_of("contact") if x.line == "h = 0.001 s" and x.x == 1e10]
    assert run("contact", cell, "hht").kind is Kind.warned
    assert run("contact", replace(cell, cause="of another kind"), "hht").kind is Kind.wrong
    assert run("contact", replace(cell, cause=""), "hht").kind is Kind.wrong
    assert not Kind.warned.misleading


def test_an_exception_is_a_crash():
    found = run("stiffness", small("stiffness")[0], Raising())
    assert found.kind is Kind.crashed and "ArithmeticError: lost" in found.message


def test_others_solvers_are_checked_by_the_small_cells(monkeypatch):
    checks = {check.name: check for check in check_solver("hht", suite="extremes")}
    assert len(checks) == sum(1 for _ in checks_of(FAMILIES)) > 60
    assert checks["rank/h = 0.01 s/0.0001"].run().kind is Kind.right
    monkeypatch.setattr(api, "check_success", lambda *_: "")
    straight = {check.name: check for check in check_solver(f"{SYNTHETIC}:Straight", suite="extremes")}
    found = straight["ratios/1 : r, stiff/100"].run()
    assert found.kind is Kind.wrong and found.message.startswith("success, but ")
    with pytest.raises(ValueError, match="claims or extremes"):
        check_solver("hht", suite="extreme")
