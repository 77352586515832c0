"""Bad requests and intervals are refused by name before anything is called."""

import numpy as np
import pytest

from hhtbench.protocol import NumpySystem
from solvers.hht import HHT
from tests.hht.scenes import Q0, V0

BAD_REQUESTS = [
    ({"rtol": -1e-6}, "rtol"),
    ({"rtol": np.nan}, "rtol"),
    ({"rtol": np.inf}, "rtol"),
    ({"rtol": "tight"}, "rtol"),
    ({"rtol": [[1e-6]]}, "rtol"),
    ({"rtol": [1e-6, -1e-6]}, "rtol"),
    ({"rtol": [1e-6, 1e-6, 1e-6]}, "rtol"),
    ({"rtol": 1e-6, "atol": [1e-6, 1e-6, 1e-6]}, "atol"),
    ({"rtol": 1e-6, "atol": -1.0}, "atol"),
    ({"rtol": 1e-6, "atol": [1e-6, np.nan]}, "atol"),
    ({"rtol": 1e-6, "atol": "x"}, "atol"),
    ({"rtol": 1e-6, "atol": [[1e-6]]}, "atol"),
    ({"rtol": 0.0, "atol": 0.0}, "rtol and atol"),
    ({"step": -0.1}, "step"),
    ({"step": 0.0}, "step"),
    ({"step": np.nan}, "step"),
    ({"step": np.inf}, "step"),
    ({"step": "0.1"}, "step"),
    ({"steps": 0}, "steps"),
    ({"steps": -3}, "steps"),
    ({"steps": 2.5}, "steps"),
    ({"steps": True}, "steps"),
    ({"steps": []}, "steps"),
    ({"steps": [0.5, -0.5, 1.0]}, "steps"),
    ({"steps": [0.5, 0.6]}, "steps"),
    ({"steps": [0.5, np.nan]}, "steps"),
    ({"step": 0.1, "steps": 10}, "step and steps"),
    ({"step": 0.1, "rtol": 1e-6}, "exclude"),
    ({"rtol": 0.0}, "rtol"),
    ({"step": 0.1, "max_num_steps": 0}, "max_num_steps"),
    ({"step": 0.1, "max_num_steps": 1.5}, "max_num_steps"),
    ({"step": 0.1, "max_evaluations": -1}, "max_evaluations"),
    ({"step": 0.1, "max_seconds": 0.0}, "max_seconds"),
    ({"step": 0.1, "max_seconds": np.nan}, "max_seconds"),
    ({"step": 0.1, "t_eval": [0.5, 0.2]}, "t_eval"),
    ({"step": 0.1, "t_eval": [0.5, 1.1]}, "t_eval"),
    ({"step": 0.1, "t_eval": [-0.1, 0.5]}, "t_eval"),
    ({"step": 0.1, "t_eval": [0.5, np.nan]}, "t_eval"),
    ({"step": 0.1, "t_eval": []}, "t_eval"),
    ({"step": 0.1, "t_eval": 0.5}, "t_eval"),
    ({"step": 0.1, "t_eval": "all"}, "t_eval"),
]


def never(*arguments):
    raise AssertionError("a callback was called")


@pytest.mark.parametrize(("request_", "name"), BAD_REQUESTS, ids=[str(request) for request, _ in BAD_REQUESTS])
def test_a_bad_request_is_refused_by_name_before_any_callback(request_, name):
    with pytest.raises((ValueError, TypeError), match=name):
        HHT(NumpySystem(force=never)).solve((0.0, 1.0), Q0, V0, **request_)
