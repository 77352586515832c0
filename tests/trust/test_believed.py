"""What ``hb.solve`` believes of a solver that is not of the bench: the velocity level, the end, a motion that is none."""

from dataclasses import replace

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.conformance.scenes.pendulum import pendulum
from tests.trust.faulty import Returning

PROBLEM = pendulum().problem
TIMES = np.linspace(*PROBLEM.t_span, 9)


def believed(change, problem=PROBLEM, **request):
    return hb.solve(problem, Returning(change=change), rtol=1e-6, **request)


def off_the_tangent(x):
    return replace(x, v=x.v + np.linspace(0.0, 3.0, x.t.size)[:, None] * x.q)


def frozen(x):
    return replace(x, **{name: np.repeat(getattr(x, name)[:1], x.t.size, axis=0) for name in ("q", "v", "lam", "mu")})


def one_ulp_short(x):
    return replace(x, t=np.append(x.t[:-1], np.nextafter(x.t[-1], x.t[0])))


def without_multipliers(x):
    return replace(x, lam=x.lam[:, :0])


WRONG = {off_the_tangent: "constraints", frozen: "motion", one_ulp_short: "end", without_multipliers: "shapes: lam has 0"}


@pytest.mark.parametrize("times", [TIMES, None], ids=["rows", "steps"])
@pytest.mark.parametrize("wrong", WRONG, ids=lambda wrong: wrong.__name__)
def test_it_is_not_believed(wrong, times):
    found = believed(wrong, t_eval=times)
    assert found.status is hb.Status.unreliable
    assert found.message.startswith(WRONG[wrong])


def test_a_consistent_start_is_not_moved_by_calc_initcond():
    """Rows of the swing from another place on the circle; an inconsistent start may be moved."""
    other = pendulum().problem.starting(q0=-PROBLEM.q0, v0=-PROBLEM.v0)
    moved = lambda x: hb.load_solver("hht").solve(other, hb.Request(rtol=1e-6, t_eval=TIMES))  # noqa: E731
    found = believed(moved, t_eval=TIMES, calc_initcond=True)
    assert found.message.startswith("start: ")
    inconsistent = PROBLEM.starting(q0=1.001 * PROBLEM.q0)
    assert hb.solve(inconsistent, "hht", rtol=1e-6, calc_initcond=True).success


def test_a_system_at_rest_may_stay_there():
    rest = hb.Problem(
        name="rest", system=hb.NumpySystem(force=lambda t, q, v: -q), q0=np.zeros(1), v0=np.zeros(1), t_span=(0.0, 9.0)
    )
    assert believed(frozen, rest).success


@pytest.mark.parametrize("rtol", [1e-2, 1e-3])
@pytest.mark.parametrize("name", ["simple_pendulum", "andrews", "knife_edge", "jay_negrut_test1", "redundant_pendulum"])
@pytest.mark.parametrize("solver", ["ida(form=index1)", "scipy(method=Radau)"])
def test_velocities_of_honest_solves_at_loose_tolerances_are(name, solver, rtol):
    found = hb.solve(name, solver, rtol=rtol)
    assert "velocity level" not in found.message
