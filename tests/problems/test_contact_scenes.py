"""Scenes with bushings and contact where their limits are closed: a bar, an impact of two, an eccentric, a band at rest."""

from functools import partial

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from hhtbench import solve
from tests.lowering.xla import values


def test_a_bar_on_a_stiff_bushing_swings_as_one_on_a_pin(make):
    """One angle: the bushing of 7e7 N/m gives way by 1e-6 m of 0.0753 m."""
    m, J, length, k, c, g = 1.8, 0.001, 0.0753, 2.0, 0.1, 9.81
    found = solve(make("bushing_chain", n_bars=1, turning_k=k, turning_c=c), "scipy(method=Radau)", rtol=1e-9)

    def rhs(t, y):
        moment = -m * g * length / 2 * np.cos(y[0]) - k * y[0] - c * y[1]
        return [y[1], moment / (J + m * length**2 / 4)]

    known = solve_ivp(rhs, (0.0, 1.0), [0.0, 0.0], method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    np.testing.assert_allclose([found.q[-1, 2], found.v[-1, 2]], known, atol=2e-5)
    np.testing.assert_allclose(found.q[-1, :2], length / 2 * np.array([np.cos(known[0]), np.sin(known[0])]), atol=2e-6)


def test_two_wagons_part_as_hunt_and_crossley_say(make):
    """Their relative speeds u and e u meet ``G(u) = G(-e u)``, ``G(v) = v - ln(1 + a v) / a``, a = 1.5 c."""
    problem = make("train_buffers", n_wagons=2)
    found, a, u = solve(problem, "scipy(method=DOP853)", rtol=1e-10), 1.5 * 0.3, 1.5
    G = lambda v: v - np.log1p(a * v) / a  # noqa: E731
    e = brentq(lambda e: G(u) - G(-e * u), 0.0, 1.0)
    np.testing.assert_allclose(make("train_buffers", n_wagons=3).system.gaps(np.zeros(3)), [0.5, 0.02, 0.02])
    np.testing.assert_allclose(found.v[-1], [u * (1 - e) / 2, u * (1 + e) / 2], atol=1e-5)  # the force 1 m apart: 1e-4 N
    assert problem.observables["last_speed"](3.0, found.q[-1], found.v[-1], None) == found.v[-1, 1]


def test_a_cam_without_backlash_lifts_as_a_scotch_yoke(make):
    problem = make("cam_follower", backlash=0.0, t_end=0.2)
    t = np.linspace(0.0, 0.2, 21)
    found = solve(problem, "projected(method=DOP853)", rtol=1e-8, t_eval=t)
    lift = np.array(
        [problem.observables["lift"](0.0, q, v, lam) for q, v, lam in zip(found.q, found.v, found.lam, strict=True)]
    )
    deepest = (3 * 2.0 * (0.02 * 40.0**2 + 9.81) / 1e8) ** (2 / 3)  # of contact, under three times the largest load
    np.testing.assert_allclose(lift, 0.02 * np.sin(40.0 * t), atol=deepest)
    assert deepest < 2e-4


def test_a_band_starts_closed_around_wheels_that_it_touches(make):
    for wrap, free in ((6, 4), (3, 1)):
        system = (problem := make("band_track", n_wrap=wrap, n_free=free)).system
        measures = (partial(system.measured, kind) for kind in ("bushing", "ball"))
        (offsets, *_), (gaps, *_) = values(measures, problem.q0, problem.v0)
        offsets = (offsets - system.elements["bushing"].free).reshape(-1, 3)
        np.testing.assert_allclose(offsets[:, :2], 0.0, atol=1e-15 * (wrap + free))
        np.testing.assert_allclose(offsets[:, 2].sum(), 2 * np.pi)
        np.testing.assert_allclose(np.sort(np.abs(gaps))[: 2 * wrap], 0.0, atol=1e-14)
        assert gaps.min() > -1e-14
