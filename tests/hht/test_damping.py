"""``rho_inf``, and ``verify damping`` in small: its rows hold, and each kind fails when the method is broken."""

from __future__ import annotations

import numpy as np
import pytest

from solvers.hht.equations.coefficients import Coefficients
from solvers.hht.solver import HHT
from solvers.hht.verify import vibration
from solvers.hht.verify.damping import one_step, overshoot, rho_inf, ringing, swing
from solvers.hht.verify.study import ALPHAS
from solvers.hht.verify.vibration import (
    closed_invariants,
    make_scene,
    measured_matrix,
    radius,
    roots,
    series,
    swing_of,
)
from tests.hht.scenes import Q0, V0, forget_code, pendulum, same_bits

IMPLICIT = {"b": 0.0, "reaction": "implicit"}
HALF = {"b": 0.25, "reaction": "implicit"}
STRONG = {**IMPLICIT, "alpha": -0.3}
CASES = ((1e-2, 0.0), (1.0, 0.05), (1e2, 0.0), (1e3, 0.05))
SCENES = ("guided", "rolling", "mixed")


def amplification_matrix(alpha, frequency, zeta):
    """The matrix (H18) itself, (3, 3), for the state (y, h z, h^2 a)."""
    c, o, e = Coefficients(alpha=alpha, b=0.0), frequency, 1.0 + alpha
    beta, gamma = c.beta, c.gamma
    rows = [
        [
            1.0 + alpha * beta * o**2 + 2.0 * e * gamma * zeta * o,
            1.0 + 2.0 * zeta * o * (e * gamma - beta),
            (1.0 - 2.0 * beta) / 2.0 + zeta * o * e * (gamma - 2.0 * beta),
        ],
        [
            -gamma * o**2,
            1.0 + e * (beta - gamma) * o**2 + 2.0 * alpha * gamma * zeta * o,
            (1.0 - gamma) + e * (2.0 * beta - gamma) * o**2 / 2.0,
        ],
        [-(o**2), -o * (e * o + 2.0 * zeta), o * e * ((2.0 * beta - 1.0) * o + 4.0 * zeta * (gamma - 1.0)) / 2.0],
    ]
    return np.array(rows) / (1.0 + 2.0 * zeta * gamma * e * o + beta * e * o**2)


def wrong(name, factor):
    """One weight of the method off by ``factor``; the closed forms do not use the property."""
    honest = getattr(Coefficients, name).fget
    return property(lambda self: factor * honest(self))


@pytest.mark.parametrize(("rho", "alpha"), [(1.0, 0.0), (0.8, -1 / 9), (0.5, -1 / 3), (0.4999999999999, -1 / 3)])
def test_rho_inf_names_the_method_of_one_alpha(rho, alpha):
    coefficients = HHT(pendulum(), rho_inf=rho).options.method().coefficients
    assert coefficients.alpha == pytest.approx(alpha, abs=1e-15)
    assert coefficients.rho_inf == pytest.approx(rho, abs=1e-12)
    assert -1 / 3 <= coefficients.alpha <= 0


def test_rho_inf_makes_the_same_steps_as_its_alpha():
    first, second = (
        HHT(pendulum(), **name).solve((0.0, 0.1), Q0, V0, step=0.01) for name in ({"rho_inf": 0.6}, {"alpha": -0.25})
    )
    assert same_bits(first, second)


@pytest.mark.parametrize(
    ("alpha", "frequency", "trace", "minors", "determinant"),
    [
        (0.0, 10.0, -1.846153846154, 1.0, 0.0),
        (-0.05, 0.1, 1.989913598113, 0.9997749642421, -0.0001125178789663),
        (-0.15, 1000.0, -1.654718453131, 0.8071840509408, -0.09640797452961),
        (-0.3, 1.0, 1.199884236928, 0.9432760949257, -0.02836195253714),
        (-1 / 3, 1e8, -1.5, 0.75, -0.125),
    ],
)
def test_the_closed_invariants_equal_stored_numbers(alpha, frequency, trace, minors, determinant):
    """Numbers to 12 digits from 60-digit arithmetic."""
    found = closed_invariants(alpha, frequency, 0.0)
    np.testing.assert_allclose(found, (trace, minors, determinant), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("alpha", "frequency", "stored"),
    [(0.0, 1e3, 1.0), (-0.05, 10.0, 0.913168287395), (-0.3, 0.1, 0.9999981746504), (-1 / 3, 1e3, 0.5078471682714)],
)
def test_closed_radius_equals_stored_numbers(alpha, frequency, stored):
    """From 60-digit arithmetic; the polynomial's coefficients are rounded, near a triple root that costs digits."""
    assert radius(roots(alpha, frequency, 0.0)) == pytest.approx(stored, abs=1e-11)


@pytest.mark.parametrize(
    ("alpha", "xi", "elongation"),
    [
        (-0.05, 5.615266642e-6, 9.480197570e-4),
        (-0.3, 1.827621913e-5, 1.243936875e-3),
        (-1 / 3, 1.841873736e-5, 1.248091235e-3),
    ],
)
def test_eigenvalues_and_series_give_stored_damping_and_elongation(alpha, xi, elongation):
    """From 60-digit arithmetic at w h = 0.1."""
    exact, leading = swing_of(roots(alpha, 0.1, 0.0), 0.1), series(alpha, 0.1)
    assert exact.damping == pytest.approx(xi, rel=1e-7)
    assert exact.elongation == pytest.approx(elongation, rel=1e-8)
    assert leading.damping == pytest.approx(xi, rel=0.01)
    assert leading.elongation == pytest.approx(elongation, rel=0.01)


@pytest.mark.parametrize("alpha", [0.0, -0.3, -1 / 3])
def test_oscillator_is_advanced_by_the_closed_matrix_up_to_infinite_frequency(alpha):
    assert all(row.passed for row in one_step("oscillator", (alpha,), IMPLICIT, (*CASES, (1e8, 0.0))))


@pytest.mark.parametrize("alpha", ALPHAS)
def test_one_step_on_the_oscillator_is_the_closed_amplification_matrix_entry_by_entry(alpha):
    measured = measured_matrix(make_scene("oscillator"), {"alpha": alpha}, 3.0, 0.05)
    np.testing.assert_allclose(measured, amplification_matrix(alpha, 3.0, 0.05), rtol=0, atol=1e-14)


@pytest.mark.parametrize("method", [IMPLICIT, HALF], ids=["b=0", "b=0.25"])
@pytest.mark.parametrize("name", SCENES)
def test_constrained_scene_is_advanced_along_its_free_direction_by_the_closed_matrix(name, method):
    """The extended form damps the force part alone: reactions do not enter the tangential motion."""
    assert all(row.passed for row in one_step(name, (-0.3,), method, CASES))
    measured = measured_matrix(make_scene(name), {**method, "alpha": -0.3}, 3.0, 0.05)
    np.testing.assert_allclose(measured, amplification_matrix(-0.3, 3.0, 0.05), rtol=0, atol=1e-13)


@pytest.mark.parametrize("rho", [1.0, 0.8, 0.5])
def test_rho_inf_is_the_measured_radius_at_infinite_frequency(rho):
    assert rho_inf(rho).passed


@pytest.mark.parametrize("alpha", [0.0, -0.3])
def test_a_long_run_has_the_damping_and_period_of_the_eigenvalues_and_of_the_series(alpha):
    rows = [
        row
        for x, periods in ((0.05, 10), (0.1, 20))
        for row in swing("oscillator", {**IMPLICIT, "alpha": alpha}, x, periods)
    ]
    assert [row.passed for row in rows] == [True] * 4


def test_a_bead_on_a_circle_has_the_damping_and_elongation_of_the_oscillator():
    """Its own period is 4 K(sin^2 A) / w, with theta = 2 phi a pendulum: 2.5e-7 longer than that of small swings."""
    assert [row.passed for row in swing("bead", {**HALF, "alpha": -0.3}, 0.1, 20)] == [True, True]


def test_overshoot_is_that_of_the_limit():
    assert all(overshoot(alpha).passed for alpha in (0.0, -0.3))


@pytest.mark.parametrize("name", ["guided", "rolling"])
def test_normal_error_in_a0_does_not_ring(name):
    assert ringing(name, (IMPLICIT, HALF)).passed


def test_tangential_error_in_a0_is_seen(monkeypatch):
    """The row can fail."""
    monkeypatch.setattr(vibration.Scene, "across", property(lambda self: self.free))
    assert not ringing("guided", (IMPLICIT,)).passed


@pytest.mark.parametrize(
    ("weight", "factor", "rows"),
    [
        ("beta", 1.0001, lambda: one_step("oscillator", (-0.3,), IMPLICIT, CASES)),
        ("gamma", 1.0001, lambda: one_step("guided", (-0.3,), HALF, CASES)),
        ("beta", 1.01, lambda: swing("oscillator", STRONG, 0.1, 20)[1:]),
        ("gamma", 1.01, lambda: swing("oscillator", STRONG, 0.1, 20)[:1]),
        ("gamma", 1.01, lambda: swing("bead", {**HALF, "alpha": -0.3}, 0.1, 20)[:1]),
        ("beta", 1.01, lambda: [rho_inf(0.8), overshoot(-0.3)]),
    ],
    ids=["matrix", "constrained matrix", "elongation", "damping", "bead", "rho_inf and overshoot"],
)
def test_wrong_weight_fails_every_row_that_depends_on_it(monkeypatch, weight, factor, rows):
    monkeypatch.setattr(Coefficients, weight, wrong(weight, factor))
    forget_code(monkeypatch)  # that made before holds the honest weight
    found = rows()
    assert found
    assert not any(row.passed for row in found)
