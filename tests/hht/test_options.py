"""Options and requests are checked by name before anything is called, the same for HHT and for its specs."""

import warnings
from dataclasses import fields

import numpy as np
import pytest

from hhtbench import load_solver
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.system import NumpySystem
from solvers.hht import HHT, HHTOptions
from tests.hht.scenes import JAX_PENDULUM, Q0, V0

KNOWN = tuple(field.name for field in fields(HHTOptions))
MAKERS = {"HHT": lambda **o: HHT(JAX_PENDULUM, **o), "spec": lambda **o: load_solver("hht", **o)}


@pytest.mark.parametrize("make", [*MAKERS.values(), HHTOptions], ids=[*MAKERS, "HHTOptions"])
@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"alpha": 0.1}, ProblemError, r"alpha must lie in \[-1/3, 0\]; got 0.1"),
        ({"alpha": -0.1, "rho_inf": 0.8}, ProblemError, "alpha = -0.1 and rho_inf = 0.8. Give one of them"),
        ({"alpha": 0.0, "rho_inf": 1.0}, ProblemError, "Give one of them"),
        ({"rho_inf": 0.49}, ProblemError, r"rho_inf must lie in \[1/2, 1\]; got 0.49"),
        ({"rho_inf": 1.01}, ProblemError, r"rho_inf must lie in \[1/2, 1\]; got 1.01"),
        ({"rho_inf": float("nan")}, ProblemError, "rho_inf must be finite"),
        ({"rho_inf": "0.8"}, TypeError, "rho_inf must be a real number"),
        ({"b": 0.5}, ProblemError, "b must not be 1/2"),
        ({"b": "0"}, TypeError, "b must be a real number"),
        ({"b": 0.1, "reaction": "midpoint"}, ProblemError, "defined for b = 0; got b = 0.1"),
        ({"reaction": "explicit"}, ProblemError, "reaction must be one of implicit, predictor, midpoint"),
        ({"start": ""}, ProblemError, "start must be one of f0, shifted, trapezoidal; got ''"),
        ({"rescale_a": 1}, TypeError, "rescale_a must be True or False; got 1"),
        ({"first_step": 1, "max_step": 0.5}, ProblemError, "must hold; got first_step=1, max_step=0.5"),
        ({"linsolver": "lu"}, ProblemError, "linsolver must be one of auto, dense, band, sparse; got 'lu'"),
        ({"without": "masses"}, ProblemError, "without must hold names of mass, reaction, zeros; got 'masses'"),
        ({"without": 1}, ProblemError, "without must hold names of .*; got 1"),
        ({"without": [[]]}, ProblemError, "without must hold names of .*; got"),
        ({"engine": None}, ProblemError, "engine must be one of compiled, python; got None"),
    ],
)
def test_a_wrong_value_is_refused_when_the_solver_is_made(make, options, error, text):
    with pytest.raises(error, match=text):
        make(**options)


def test_a_warning_about_b_points_at_the_line_that_gave_it():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        HHT(JAX_PENDULUM, b=0.45)
    assert [(w.filename, "close to the singular value" in str(w.message)) for w in caught] == [(__file__, True)]


def test_close_to_one_half_a_run_fails_after_a_warning():
    with pytest.warns(UserWarning, match="1/2"):
        solution = HHT(JAX_PENDULUM, b=0.5 + 1e-12).solve((0, 1), Q0, V0, steps=10)
    assert not solution.success


def test_only_under_error_control_the_default_start_is_trapezoidal():
    assert [HHTOptions().method(controlled=c).start for c in (False, True)] == ["f0", "trapezoidal"]
    assert [HHTOptions(start="shifted").method(controlled=c).start for c in (False, True)] == ["shifted"] * 2


def test_help_of_the_solver_names_every_option_and_where_each_is_described():
    assert [name for name in KNOWN if f"``{name}``" not in HHT.__doc__] == []
    assert "HHTOptions" in HHT.__doc__
    assert [name for name in KNOWN if name not in HHTOptions.__doc__] == []


def test_options_in_the_wrong_place_are_refused():
    with pytest.raises(TypeError, match="when it is made"):
        HHT(JAX_PENDULUM).solve((0, 1), Q0, V0, steps=2, options={"alpha": -0.2})
    with pytest.raises(TypeError, match="calc_initcond"):
        HHT(JAX_PENDULUM, calc_initcond=True)


BAD_REQUESTS = [
    ({"steps": []}, "steps"),
    ({"steps": [0.5, -0.5, 1.0]}, "steps"),
    ({"steps": [0.5, 0.6]}, "steps"),
    ({"steps": [0.5, np.nan]}, "steps"),
    ({"step": 0.1, "steps": 10}, "step and steps"),
    ({"step": 0.1, "max_seconds": np.nan}, "max_seconds"),
]


def never(*arguments):
    raise AssertionError("a callback was called")


@pytest.mark.parametrize(("request_", "name"), BAD_REQUESTS, ids=[str(request) for request, _ in BAD_REQUESTS])
def test_a_bad_request_is_refused_by_name_before_any_callback(request_, name):
    with pytest.raises((ValueError, TypeError), match=name):
        HHT(NumpySystem(force=never)).solve((0.0, 1.0), Q0, V0, **request_)
