"""Wrong parameters are refused at once, naming the parameter and its range."""

import importlib
import inspect
import math

import pytest

from hhtbench.catalogue.registry import list_problems, load_problem
from hhtbench.protocol.errors import ProblemError

ONE = [  # name, parameter, its default
    (name, key, parameter.default)
    for name in list_problems()
    for key, parameter in inspect.signature(importlib.import_module(f"problems.{name}").problem).parameters.items()
]
WHOLE = [(name, key) for name, key, default in ONE if isinstance(default, int)]
REAL = [(name, key) for name, key, default in ONE if not isinstance(default, int)]
CHOSEN = [(name, key) for name, key, default in ONE if default is None]  # by the problem, from other parameters


def test_every_parameter_has_a_number_as_default_or_is_chosen_by_the_problem():
    assert all(isinstance(default, (int, float, type(None))) for _, _, default in ONE)
    assert {key for _, key in CHOSEN} == {"j0"}
    assert {name for name, _, _ in ONE} == set(list_problems())


@pytest.mark.parametrize(("name", "key"), REAL)
def test_value_that_is_no_finite_number_is_refused_by_name(make, name, key):
    with pytest.raises(ProblemError, match=rf"^{key} must be finite"):
        make(name, **{key: math.nan})
    with pytest.raises(ProblemError, match=rf"^{key} must be finite"):
        make(name, **{key: -math.inf})
    for value in ("5", [1.0, 2.0], *(() if (name, key) in CHOSEN else (None,))):
        with pytest.raises(TypeError, match=rf"^{key} must be a real number"):
            make(name, **{key: value})


@pytest.mark.parametrize(("name", "key"), WHOLE)
def test_count_that_is_no_whole_number_of_at_least_one_is_refused_by_name(make, name, key):
    for value in (0, -1):
        with pytest.raises(ProblemError, match=rf"^{key} must be at least \d.*got {value}"):
            make(name, **{key: value})
    for value in (2.0, "2", None):
        with pytest.raises(TypeError, match=rf"^{key} must be a whole number"):
            make(name, **{key: value})


@pytest.mark.parametrize("name", list_problems())
def test_interval_without_length_is_refused(make, name):
    start = make(name).t_span[0]
    with pytest.raises(ProblemError, match=r"^t_end must be above .*\[(s|1)\]; got"):
        make(name, t_end=start)


@pytest.mark.parametrize("name", list_problems())
def test_unknown_parameter_is_refused_with_the_known_ones(make, name):
    with pytest.raises(ProblemError, match=r"lenght.*Known parameters: .*t_end"):
        load_problem(name, lenght=2.0)
    with pytest.raises(TypeError, match="lenght"):
        make(name, lenght=2.0)


WRONG = [
    ("andrews", {"c0": -5}, r"c0 must be at least 0 \[N/m\]; got -5"),
    ("andrews", {"l0": -5}, r"l0 must be at least 0 \[m\]; got -5"),
    ("arevalo_circle", {"c": 0.0}, r"c must be above 0 \[1\]; got 0"),
    ("arevalo_circle", {"t_end": 1.0}, r"t_end must be above t_start = 1 \[1\]; got 1"),
    ("arevalo_circle", {"t_start": -1.0}, r"t_start must be at least 0 \[1\]; got -1"),
    ("ball_mill", {"n_balls": 6}, r"n_balls must be at least 1 and at most 5.*got 6"),
    ("ball_mill", {"mu": -0.1}, r"mu must be at least 0 \[1\]; got -0.1"),
    ("band_track", {"n_wrap": 2}, r"n_wrap must be at least 3, for a band around a wheel; got 2"),
    ("band_track", {"creep": 0.0}, r"creep must be above 0 \[m/s\]; got 0"),
    ("bead_chain", {"n_beads": -1}, r"n_beads must be at least 1; got -1"),
    ("bead_chain", {"g": 0}, r"g must be above 0 \[m/s\^2\]; got 0"),
    ("bead_on_rotating_rod", {"r0": 0.0}, r"r0 must be above 0 \[m\]; got 0"),
    ("bead_on_rotating_rod", {"u0": -1.0}, r"u0 must be at least 0 \[m/s\]; got -1"),
    ("bead_on_rotating_rod", {"Om": 0.0}, r"Om must be at least 0.01 \[rad/s\]; got 0"),
    ("belt_drive", {"n_elements": 7}, r"n_elements must be at least 8.*got 7"),
    ("belt_drive", {"mu": -0.1}, r"mu must be at least 0 \[1\]; got -0.1"),
    ("bricard", {"a": 0}, r"a must be above 0 \[m\]; got 0"),
    ("cable_pendulum", {"dimension": 4}, r"dimension must be at least 2.*and at most 3.*got 4"),
    ("cable_pendulum", {"EA": 0.0}, r"EA must be above 0 \[N\]; got 0"),
    ("bushing_chain", {"n_bars": 0}, r"n_bars must be at least 1; got 0"),
    ("bushing_chain", {"c": -1.0}, r"c must be at least 0 \[N s/m\]; got -1"),
    ("cam_follower", {"ecc": 0.05}, r"ecc must be above 0 and below 0.05 \[m\]; got 0.05"),
    ("cam_follower", {"onset": 0.0}, r"onset must be above 0 \[m\]; got 0"),
    ("car_axis", {"r": 1.0}, r"r must be above 0 and below 1 \[m\]; got 1"),
    ("car_axis", {"L": 0.0}, r"L must be above 0 \[m\]; got 0"),
    ("car_axis", {"grav": -1.0}, r"grav must be at least 0 \[m/s\^2\]; got -1"),
    ("chaplygin_sleigh", {"a": 0.0}, r"a must be at least 0.001 \[m\]; got 0"),
    ("chaplygin_sleigh", {"w0": -1.0}, r"w0 must be at least 0.001 \[rad/s\]; got -1"),
    ("chaplygin_sleigh", {"I": 0.0}, r"I must be above 0 \[kg m\^2\]; got 0"),
    ("clamped_bar_impact", {"n_elements": 0}, r"n_elements must be at least 1; got 0"),
    ("clamped_bar_impact", {"speed": 0.0}, r"speed must be above 0 \[m/s\]; got 0"),
    ("driven_coordinate", {"w": 0.0}, r"w must be above 0 \[rad/s\]; got 0"),
    ("falling_net", {"n_side": 2}, r"n_side must be at least 3.*got 2"),
    ("falling_net", {"width": 0.0}, r"width must be above 0 \[m\]; got 0"),
    ("fekete", {"n_points": 1}, r"n_points must be at least 2.*got 1"),
    ("fekete", {"damping": -0.1}, r"damping must be at least 0 \[N s/m\]; got -0.1"),
    ("flexible_crank", {"n_elements": 0}, r"n_elements must be at least 1; got 0"),
    ("flexible_crank", {"Om": 0.0}, r"Om must be above 0 \[rad/s\]; got 0"),
    ("flyball_governor", {"C": -1}, r"C must be at least 0 \[N s/m\]; got -1"),
    ("flyball_governor", {"s": 1}, r"s must be above 0 and below 1 \[m\]; got 1"),
    ("flyball_governor", {"alpha": 2}, r"alpha must be above -1.57\d* and below 1.57\d* \[rad\]; got 2"),
    ("four_bars", {"n_windows": 0}, r"n_windows must be at least 1; got 0"),
    ("four_bars", {"speed": 0}, r"speed must be above 0 \[m/s\]; got 0"),
    ("fput_chain", {"beta": -0.1}, r"beta must be at least 0 \[N/m\^3\]; got -0.1"),
    ("fput_chain", {"amplitude": 0.0}, r"amplitude must not be 0 \[m\].*got 0"),
    (
        "fput_chain",
        {"beta": 0.0, "alpha": 1.0, "amplitude": 3.0},
        r"amplitude must give less energy.*= 0.166667 \[J\]; got 2.44",
    ),
    ("heavy_top", {"m": 0}, r"m must be above 0 \[kg\]; got 0"),
    ("heavy_top", {"l": -1}, r"l must be above 0 \[m\]; got -1"),
    ("heavy_top", {"j0": -1}, r"j0 must be at least 0 \[kg m\^2\]; got -1"),
    ("hf_linear_constrained", {"stiffness": 0.0}, r"stiffness must be above 0 \[N/m\]; got 0"),
    ("jay_negrut_pendulum", {"m": -1}, r"m must be above 0 \[kg\]; got -1"),
    ("jay_negrut_pendulum", {"L": 0}, r"L must be above 0 \[m\]; got 0"),
    ("jay_negrut_pendulum", {"k": -1e-9}, r"k must be at least 0 \[N m/rad\]; got -1e-09"),
    ("jay_negrut_test1", {"t_end": 0.0}, r"t_end must be above 0 \[s\]; got 0"),
    ("kapitza_pendulum", {"A": -0.1}, r"A must be at least 0 \[m\]; got -0.1"),
    ("kapitza_pendulum", {"L": 0.0}, r"L must be above 0 \[m\]; got 0"),
    ("knife_edge", {"incline": 2}, r"incline must be at least 0 and below 1.5707\d* \[rad\]; got 2"),
    ("knife_edge", {"Om": 0.001}, r"Om must be at least 0.01 \[rad/s\]; got 0.001"),
    ("mooring_line", {"n_segments": 1}, r"n_segments must be at least 2.*got 1"),
    ("mooring_line", {"pull_x": 0.0}, r"pull_x must be above 0 \[N\]; got 0"),
    ("nonholonomic_particle", {"vy": 0.0}, r"vy must be at least 0.01 \[m/s\]; got 0"),
    ("nonholonomic_particle", {"m": 0.0}, r"m must be above 0 \[kg\]; got 0"),
    ("oscillator_chain", {"n_masses": 1}, r"n_masses must be at least 2.*got 1"),
    ("oscillator_chain", {"k": 0}, r"k must be above 0 \[N/m\]; got 0"),
    ("pendulum_period2", {"L": 0.0}, r"L must be above 0 \[m\]; got 0"),
    ("pendulum_period2", {"t_end": 0.0}, r"t_end must be above 0 \[s\]; got 0"),
    ("planar_chain", {"n_links": 0}, r"n_links must be at least 1; got 0"),
    ("planar_chain", {"L": 0}, r"L must be above 0 \[m\]; got 0"),
    ("redundant_pendulum", {"factor": 0.0}, r"factor must be above 0 \[1\]; got 0"),
    ("redundant_pendulum", {"amplitude": -4.0}, r"amplitude must be at least -3.1 and below 3.1 \[rad\]; got -4"),
    ("right_angle_cantilever", {"n_elements": 0}, r"n_elements must be at least 1; got 0"),
    ("right_angle_cantilever", {"GJ": 0.0}, r"GJ must be above 0 \[N m\^2\]; got 0"),
    ("rolling_disk3d_steady", {"theta": 0}, r"theta must be above 0 and below 1.5707\d* \[rad\]; got 0"),
    ("rolling_disk3d_steady", {"j0": -1}, r"j0 must be at least 0 \[kg m\^2\]; got -1"),
    ("rolling_disk_incline", {"Om": 0.0}, r"Om must be at least 0.01 \[rad/s\]; got 0"),
    ("rolling_disk_incline", {"R": -0.5}, r"R must be above 0 \[m\]; got -0.5"),
    ("rolling_sphere_table", {"R": 0}, r"R must be above 0 \[m\]; got 0"),
    ("rolling_sphere_table", {"Om": math.inf}, r"Om must be finite"),
    ("simple_pendulum", {"amplitude": 3.2}, r"amplitude must be at least -3.1 and below 3.1 \[rad\]; got 3.2"),
    ("simple_pendulum", {"g": 0.0}, r"g must be above 0 \[m/s\^2\]; got 0"),
    ("slider_crank_equal_lengths", {"angle": 1.6}, r"angle must be above -1.57\d* and below 1.57\d* \[rad\]"),
    ("slider_crank_equal_lengths", {"m_slider": 0}, r"m_slider must be above 0 \[kg\]; got 0"),
    ("slider_crank_flexible", {"E": 0.0}, r"E must be above 0 \[Pa\]; got 0"),
    ("slider_crank_flexible", {"t_end": 0.0}, r"t_end must be above 0 \[s\]; got 0"),
    ("spinup_beam", {"n_elements": 0}, r"n_elements must be at least 1; got 0"),
    ("spinup_beam", {"spin_up": 0.0}, r"spin_up must be above 0 \[s\]; got 0"),
    ("stiff_spring_pendulum", {"stiffness": 0}, r"stiffness must be above 0 \[N/m\]; got 0"),
    ("sundials_slider_crank", {"a": 1.0}, r"a must be above 0 and below 1 \[m\]; got 1"),
    ("sundials_slider_crank", {"c": -1.0}, r"c must be at least 0 \[N s/m\]; got -1"),
    ("train_buffers", {"n_wagons": 1}, r"n_wagons must be at least 2.*got 1"),
    ("train_buffers", {"run": 0.0}, r"run must be above 0 \[m\]; got 0"),
]


@pytest.mark.parametrize(("name", "parameters", "text"), WRONG)
def test_value_outside_its_range_is_refused_with_the_range(make, name, parameters, text):
    with pytest.raises(ProblemError, match=text):
        make(name, **parameters)


def test_no_problem_is_without_a_value_outside_its_range():
    assert {name for name, _, _ in WRONG} == set(list_problems())


def test_only_the_word_for_infinity_names_the_rigid_limit(make):
    with pytest.raises(TypeError, match=r"stiffness must be a real number \[N/m\]"):
        make("stiff_spring_pendulum", stiffness="rigid")
    assert make("stiff_spring_pendulum", stiffness="inf").q0.size == 4


def test_time_outside_the_pendulum_solution_is_refused(make):
    with pytest.raises(ProblemError, match=r"t must be in \[0, 4\] \[s\].*got 4.5"):
        make("jay_negrut_pendulum").exact(4.5)
