"""Wrong parameters are refused at once, naming the parameter and its range."""

import pytest

from hhtbench.errors import ProblemError

WRONG = [
    ("jay_negrut_test1", {"t_end": 0.0}, r"t_end must be above 0 \[s\]; got 0"),
    ("jay_negrut_pendulum", {"m": -1}, r"m must be above 0 \[kg\]; got -1"),
    ("jay_negrut_pendulum", {"L": 0}, r"L must be above 0 \[m\]; got 0"),
    ("jay_negrut_pendulum", {"k": -1e-9}, r"k must be at least 0 \[N m/rad\]; got -1e-09"),
    ("jay_negrut_pendulum", {"c": float("nan")}, r"c must be finite"),
    ("andrews", {"c0": -5}, r"c0 must be at least 0 \[N/m\]; got -5"),
    ("andrews", {"l0": -5}, r"l0 must be at least 0 \[m\]; got -5"),
    ("knife_edge", {"incline": 2}, r"incline must be at least 0 and below 1.5707\d* \[rad\]; got 2"),
    ("knife_edge", {"Om": 0.001}, r"Om must be at least 0.01 \[rad/s\]; got 0.001"),
    ("rolling_disk3d_steady", {"theta": 0}, r"theta must be above 0 and below 1.5707\d* \[rad\]; got 0"),
    ("rolling_disk3d_steady", {"j0": -1}, r"j0 must be at least 0 \[kg m\^2\]; got -1"),
    ("oscillator_chain", {"n_masses": 1}, r"n_masses must be at least 2.*got 1"),
    ("oscillator_chain", {"k": 0}, r"k must be above 0 \[N/m\]; got 0"),
]


@pytest.mark.parametrize(("name", "parameters", "text"), WRONG)
def test_value_outside_its_range_is_refused_with_the_range(make, name, parameters, text):
    with pytest.raises(ProblemError, match=text):
        make(name, **parameters)


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("jay_negrut_pendulum", {"length": 2.0}),
        ("jay_negrut_pendulum", {"m": "5"}),
        ("andrews", {"mom": None}),
        ("oscillator_chain", {"n_masses": 2.0}),
    ],
)
def test_unknown_name_or_wrong_type_is_a_type_error(make, name, parameters):
    with pytest.raises(TypeError, match=next(iter(parameters))):
        make(name, **parameters)


def test_time_outside_the_pendulum_solution_is_refused(make):
    with pytest.raises(ProblemError, match=r"t must be in \[0, 4\] \[s\].*got 4.5"):
        make("jay_negrut_pendulum").exact(4.5)
