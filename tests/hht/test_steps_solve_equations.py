"""Every accepted step satisfies the equations of its method, by an oracle that shares no code with the loops."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.registry import list_problems, load_problem
from solvers.hht import HHT
from solvers.hht.rivals import GeneralisedAlphaIntegrator, HHTI3Integrator, RattleIntegrator
from tests.hht.oracle import (
    LEFT_BY_CONTROL,
    HHTI3,
    Extended,
    GeneralisedAlpha,
    Rattle,
    physics_of,
    steps_of,
)
from tests.problems.mechanics import Mechanics

RTOL = 1e-3
ROUNDOFF = 1e-12  # of the largest q and v; Newton's iteration ends at 1e-13
NOISY = {"flyball_governor": 1e-9}  # its light joints make M^-1 F noise: 2e-12 of v by one roundoff of q


def tolerances(problem):
    n = problem.q0.size
    return RTOL * np.concatenate([np.broadcast_to(problem.scales.q, n), np.broadcast_to(problem.scales.v, n)])


def assert_solved(left, s, rtol=None, atol=0.0, roundoff=ROUNDOFF):
    """Forces to the part of the tolerance that (H35) leaves, or to roundoff; constraints to roundoff always."""
    worst = left.of_sizes(s, forces=rtol is None)
    assert worst.max() <= roundoff, f"step {worst.argmax()} of {worst.size} leaves {worst.max():.1e} of q or v"
    if rtol is not None:
        of_forces = left.of_tolerance(s, rtol, atol)
        assert of_forces.max() <= LEFT_BY_CONTROL, f"step {of_forces.argmax()} of {of_forces.size}: {of_forces.max():.1e}"


# --- the library


@pytest.mark.parametrize("name", list_problems())
@pytest.mark.filterwarnings("ignore:redundant constraints")
def test_every_step_of_the_library_solves_its_equations(name):
    """Under error control to an end that cuts the last step, then in prescribed steps 1 : 2 of about half that length."""
    problem = load_problem(name)
    atol = tolerances(problem)
    hht, physics, roundoff = HHT(problem.system), physics_of(problem.system), NOISY.get(name, ROUNDOFF)

    def solve(end, **how):
        guesses = {"lam_guess": problem.lam_guess, "mu_guess": problem.mu_guess}
        return hht.solve((problem.t_span[0], end), problem.q0, problem.v0, **guesses, **how)

    ahead = solve(problem.t_span[1], rtol=RTOL, atol=atol, max_num_steps=25)
    controlled = solve(ahead.t[-1] - 0.3 * (ahead.t[-1] - ahead.t[-2]), rtol=RTOL, atol=atol)
    s = steps_of(controlled, problem.system)
    assert_solved(Extended().left(physics, s, start="trapezoidal"), s, RTOL, atol, roundoff)
    lengths = np.median(s.h) / 2 * np.tile([1.0, 2.0], 10)
    lengths[-1] *= 0.3
    prescribed = solve(problem.t_span[0] + lengths.sum(), steps=lengths)
    assert prescribed.success
    assert controlled.success
    s = steps_of(prescribed, problem.system)
    assert_solved(Extended().left(physics, s), s, roundoff=roundoff)
