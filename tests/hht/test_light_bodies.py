"""Failures of runs with bodies of masses far apart: what they are told to come from."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import hhtbench as hb
from hhtbench.lowering import derive
from solvers._start import Place
from solvers.hht.run.singular import places_of, singular_position

BARS = hb.load_problem("four_bars(n_windows=1, t_end=1.0)")
FLAT = brentq(lambda t: BARS.exact(t).q[2], 0.6, 0.8)  # [s]: horizontal bars


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
    assert (found.rank, found.rows) == (7, 8)
    assert found.t == pytest.approx(FLAT, abs=1e-6)
