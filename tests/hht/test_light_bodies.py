"""Failures of runs with bodies of masses far apart: what they are told to come from."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import hhtbench as hb
from hhtbench.lowering import derive
from hhtbench.result import Status
from hhtbench.testing.extremes.linkages import DoublePendulum
from solvers._start import Place
from solvers.hht.run.singular import places_of, singular_position
from tests.hht.scenes import pendulum

BARS = hb.load_problem("four_bars(n_windows=1, t_end=1.0)")
FLAT = brentq(lambda t: BARS.exact(t).q[2], 0.6, 0.8)  # [s]: horizontal bars


@pytest.mark.parametrize("ratio", [1e6, 1e12])
@pytest.mark.parametrize("options", [{"b": 0.0}, {"extrapolate_reaction": True}], ids=str)
def test_rods_that_a_light_body_joins_keep_their_rank_where_they_are_straight(ratio, options):
    """Bent rods swing straight at 0.4745 s: over the root of the mass their rows are nearly one and the same."""
    solution = hb.HHT(DoublePendulum(ratio=ratio), **options).solve((0.0, 1.0), *DoublePendulum.bent(1.2, -1.0), step=0.01)
    assert solution.status is Status.newton_failed
    assert "lose rank" not in solution.message
    assert "Near t = 0.4745" in solution.message and "the constraints keep their rank" in solution.message


def test_so_they_do_under_error_control():
    solution = hb.HHT(DoublePendulum(ratio=1e12)).solve((0.0, 1.0), *DoublePendulum.bent(1.0, 0.2), rtol=1e-3)
    assert solution.status is Status.step_too_small
    assert "the constraints keep their rank" in solution.message


class Pulled(DoublePendulum):
    """Pulled straight by far more than its weight."""

    def force(self, t, q, v):
        return super().force(t, q, v) + jnp.array([0.0, 0.0, 0.0, -200.0])


@pytest.mark.parametrize("options", [{}, {"alpha": -0.2, "extrapolate_reaction": True}], ids=str)
@pytest.mark.parametrize("steps", [50, 500])
@pytest.mark.parametrize("angle", [0.3, 0.5, 0.8, 1.2])
def test_what_throws_a_light_body_about_is_named_though_no_row_loses_rank(angle, steps, options):
    """Where rods are straight the least singular value is small by the light body, and does not vanish."""
    solution = hb.HHT(Pulled(ratio=1e6), **options).solve((0.0, 1.0), *DoublePendulum.bent(angle, -0.4), steps=steps)
    assert solution.status is Status.newton_failed
    assert "the constraints keep their rank, but over the root of the mass" in solution.message


class Uneven(type(BARS.system)):
    """Four bars of which each has its own mass; the motions are the same but for the pace."""

    masses: object = None

    @property
    def mass_matrix(self):
        return jnp.repeat(self.masses, 3) * super().mass_matrix


@pytest.mark.parametrize("which", [(0,), (1,), (2,), (0, 1), (1, 2)])
@pytest.mark.parametrize("size", [1e-12, 1e-6, 1e6])
def test_rank_that_is_lost_is_lost_with_light_and_heavy_bodies(size, which):
    masses = np.ones(3)
    masses[list(which)] = size
    given = BARS.system
    system = Uneven(m=given.m, l=given.l, g=given.g, n_windows=given.n_windows, masses=jnp.asarray(masses))
    times = np.linspace(0.5, FLAT - 1e-4, 100)
    motion = [BARS.exact(t) for t in times]
    places = places_of(times[:, None], np.array([x.q for x in motion]), np.array([x.v for x in motion]))
    found = singular_position(derive(system, 0.0, BARS.q0, BARS.v0), Place(0.0, BARS.q0, BARS.v0), places, 1e-3)
    assert (found.rank, found.rows, found.by_mass) == (7, 8, False)
    assert found.t == pytest.approx(FLAT, abs=1e-6)


@pytest.mark.parametrize(("ratio", "alpha"), [(1e9, -0.02), (1e10, -0.2)])
def test_a_failure_by_what_extrapolation_errs_by_names_the_vibration(ratio, alpha):
    """Steps of 0.04 s, h omega = 2,000 and more; what the message advises goes on.

    What grows begins as roundoff: of several starts some fail, on any machine.
    """
    extrapolated = hb.HHT(DoublePendulum(ratio=ratio), extrapolate_reaction=True, alpha=alpha)
    given = [((0.0, 1.0), *DoublePendulum.straight(0.5 * (1.0 + 1e-6 * k))) for k in range(8)]
    ended = [extrapolated.solve(*each, step=0.04) for each in given]
    failed = [solution for solution in ended if not solution.success]
    assert failed
    for solution in failed:
        assert solution.status is Status.newton_failed
        assert "carry a vibration of" in solution.message and "(H55)" in solution.message
        assert "take alpha nearer -1/3, shorter steps, or error control" in solution.message
    assert extrapolated.solve(*given[0], step=0.01).success
    assert extrapolated.solve(*given[0], rtol=1e-3).success


def test_other_failures_with_it_do_not_speak_of_vibrations():
    jump = pendulum(force=lambda t, q, v: np.array([-1e8 * np.sign(q[0] - 0.05), -9.81]))
    solution = hb.HHT(jump, extrapolate_reaction=True).solve((0.0, 1.0), [0.0, -1.0], [1.0, 0.0], step=1e-2)
    assert solution.status is Status.newton_failed
    assert "vibration" not in solution.message
