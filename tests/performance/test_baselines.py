"""The hand-written C steps are the library's steps."""

from dataclasses import replace

import numpy as np
import pytest

from solvers.hht import HHT
from tests.performance.engine import baselines

pytestmark = pytest.mark.skipif(baselines.compiler() is None, reason="there is no C compiler")
ALL = baselines.cases(0.0125)
CASES = {case.name: case for case in ALL if case.rtol is None}


@pytest.fixture(scope="module")
def functions(tmp_path_factory):
    return baselines.build(tmp_path_factory.mktemp("baselines"))


@pytest.mark.parametrize("name", CASES)
def test_c_and_library_hold_the_same_trajectory(functions, name):
    case = CASES[name]
    steps = min(case.steps, 150)
    problem, end = case.problem, case.h * steps
    guess = {"lam_guess": problem.lam_guess}
    hht = HHT(problem.system, alpha=baselines.ALPHA, b=0.0)
    solution = hht.solve((0.0, end), problem.q0, problem.v0, steps=steps, t_eval=[end], **guess)
    ours = baselines.End(solution.q[-1], solution.v[-1], 0)
    theirs = baselines.take_steps(functions[case.source], case, steps)
    assert np.abs(ours.q - problem.q0).max() > 1e-5, "it has moved"
    assert baselines.difference(ours, theirs) < 1e-11
    assert 1.0 <= theirs.iterations / steps <= 4.0, "full Newton needs no more"


@pytest.mark.parametrize("rtol", [1e-4, 1e-6])
def test_c_and_library_control_the_error_alike(functions, rtol):
    """The same steps but for the matrix that filters the error, which C makes anew and the library may keep."""
    case = next(case for case in baselines.cases(0.1) if case.rtol is not None)
    case = replace(case, rtol=rtol)
    problem = case.problem
    hht = HHT(problem.system, alpha=baselines.ALPHA, b=0.0)
    asked = {"atol": rtol, "t_eval": [problem.t_span[1]], "lam_guess": problem.lam_guess}
    ours = hht.solve(problem.t_span, problem.q0, problem.v0, rtol=rtol, **asked)
    exact = hht.solve(problem.t_span, problem.q0, problem.v0, rtol=1e-3 * rtol, **(asked | {"atol": 1e-3 * rtol}))
    theirs = baselines.take_controlled(functions["control"], case, baselines.after_first_steps(case))
    assert theirs.accepted + baselines.FIRST == pytest.approx(ours.counters.steps_accepted, rel=0.02)
    errors = [np.abs(q - exact.q[-1]).max() for q in (ours.q[-1], theirs.end.q)]
    assert errors[1] == pytest.approx(errors[0], rel=0.5)
    assert 1.0 <= theirs.end.iterations / theirs.accepted <= 4.0, "full Newton needs no more"


@pytest.mark.parametrize(
    ("name", "h", "steps", "most"), [("the same undamped, 100 s", 0.02, 60, 3.75), ("andrews, 0.03 s", 1e-4, 300, 3.05)]
)
def test_the_matrices_of_c_are_exact(functions, name, h, steps, most):
    """Newton's iterations at steps so coarse that a missing derivative shows."""
    case = replace(CASES[name], h=h)
    assert baselines.take_steps(functions[case.source], case, steps).iterations / steps <= most


def test_c_says_when_newton_fails(functions):
    case = next(case for case in CASES.values() if case.source == "andrews")
    broken = replace(case, h=np.nan, steps=3)
    with pytest.raises(RuntimeError, match="Newton"):
        baselines.take_steps(functions["andrews"], broken)


def test_difference_is_relative_to_each_of_q_and_v():
    one = baselines.End(np.array([1.0, 0.0]), np.array([1000.0, 0.0]), 0)
    other = baselines.End(np.array([1.0, 0.0]), np.array([1000.0, 1.0]), 0)
    assert baselines.difference(one, other) == pytest.approx(1e-3)
