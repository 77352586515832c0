"""``rho_inf``, and ``verify damping`` on scenes with constraints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solvers.hht.solver import HHT
from solvers.hht.verify import damping
from solvers.hht.verify.damping import (
    ROWS,
    STEP,
    make_scene,
    one_step,
    swing,
)
from solvers.hht.verify.measure import step_by_hand
from tests.hht.scenes import pendulum
from tests.sample import slow

IMPLICIT = {"b": 0.0, "reaction": "implicit"}
HALF = {"b": 0.25, "reaction": "implicit"}
CASES = ((1e-2, 0.0), (1.0, 0.05), (1e2, 0.0), (1e3, 0.05))
SCENES = ("guided", "rolling", "mixed")


def across(scene):
    """A unit direction (n,) in which only a reaction acts."""
    normal = np.linalg.solve(scene.mass, ROWS[0])
    return normal / np.linalg.norm(normal)


@pytest.mark.parametrize(("rho", "alpha"), [(1.0, 0.0), (0.8, -1 / 9), (0.5, -1 / 3), (0.4999999999999, -1 / 3)])
def test_rho_inf_names_the_method_of_one_alpha(rho, alpha):
    coefficients = HHT(pendulum(), rho_inf=rho).options.method().coefficients
    assert coefficients.alpha == pytest.approx(alpha, abs=1e-15)
    assert coefficients.rho_inf == pytest.approx(rho, abs=1e-12)
    assert -1 / 3 <= coefficients.alpha <= 0


def rows_of(measure, *first):
    """Those that ``verify damping`` measures so."""
    studies = [study for study in damping.STUDIES if study[: 1 + len(first)] == (measure, *first)]
    found = [row for measure, *given in studies for row in np.atleast_1d(measure(*given))]
    assert found
    return found


def test_one_step_of_an_oscillator_is_the_closed_matrix():
    assert [row.claim for row in rows_of(one_step, "oscillator") if not row.passed] == []


def test_the_fastest_vibration_keeps_rho_inf():
    assert [row.claim for row in rows_of(damping.rho_inf) if not row.passed] == []


def test_an_oscillator_has_the_damping_and_elongation_of_the_series():
    assert [row.claim for row in rows_of(swing, "oscillator") if not row.passed] == []


def test_the_first_step_overshoots_as_the_limit_says():
    assert [row.claim for row in rows_of(damping.overshoot) if not row.passed] == []


@pytest.mark.parametrize(
    ("name", "method"), [("guided", IMPLICIT), ("rolling", HALF), ("mixed", HALF), slow("mixed", IMPLICIT)]
)
def test_constrained_scene_is_advanced_along_its_free_direction_by_the_closed_matrix(name, method):
    """The extended form damps the force part alone: reactions do not enter the tangential motion."""
    assert one_step(name, (-0.3,), method, CASES).passed


def test_a_bead_on_a_circle_has_the_damping_and_elongation_of_the_oscillator():
    """Its own period is 4 K(sin^2 A) / w, with theta = 2 phi a pendulum: 2.5e-7 longer than that of small swings."""
    assert [row.passed for row in swing("bead", {**HALF, "alpha": -0.3}, 0.1, 20)] == [True, True]


def five_states(scene, method, error):
    """After a start at rest with ``error`` (n,) in a0."""
    hht = scene.integrator(method, 0.1)
    hht.init_step(0.0, scene.free, np.zeros(scene.free.size), step=STEP)
    hht.restart(replace(hht.state, a=hht.state.a + error, h=STEP))
    return [step_by_hand(scene.name, hht) for _ in range(5)]


@pytest.mark.parametrize(
    ("name", "method", "alpha"),
    [
        (name, method, alpha) if (i + j) % 3 == 0 else slow(name, method, alpha)
        for i, name in enumerate(SCENES)
        for j, method in enumerate(damping.METHODS)
        for alpha in (0.0, -0.3)
    ],
)
def test_an_error_of_a0_across_the_constraints_does_not_ring_and_one_along_them_does(name, method, alpha):
    """The multipliers of the step itself take it up.

    With velocity constraints q keeps (alpha h)^2 / 4 of it, and later multipliers the force of a spring stretched by that.
    """
    scene, method = make_scene(name), {**method, "alpha": alpha}
    honest, *others = (five_states(scene, method, error) for error in (0.0, across(scene), scene.free))

    def change(of, *names):
        return max(
            np.abs(getattr(a, x) - getattr(b, x)).max(initial=0.0) for a, b in zip(honest, of, strict=True) for x in names
        )

    assert change(others[0], "q", "v") < 1e-5 < 1e-3 < change(others[1], "q", "v")
    later = [np.abs(np.concatenate([a.lam - b.lam, a.mu - b.mu])).max() for a, b in zip(honest, others[0], strict=True)][1:]
    assert max(later) < 1e-5 * min(np.abs(np.concatenate([a.lam, a.mu])).max() for a in honest[1:])
