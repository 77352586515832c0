"""Car axis, published elsewhere as unsolved by IDA: solved on four forms (Test Set for IVP Solvers, car axis)."""

import numpy as np
import pytest

from hhtbench.api import solve
from hhtbench.catalogue.registry import load_problem


@pytest.mark.parametrize("form", ["ggl", "index1", "integrated", "index2"])
def test_ida_solves_the_car_axis(form):
    problem = load_problem("car_axis")
    known = problem.reference
    solution = solve(problem, f"ida(form={form})", rtol=1e-8, t_eval=known["t"])
    assert solution.success, solution.message
    for name, scale in (("q", problem.scales.q), ("v", problem.scales.v)):
        assert np.max(np.abs(getattr(solution, name) - known[name]) / scale) < 1e-4
