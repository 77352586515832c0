"""What the pages of docs/ show runs as printed, and does what a solver and a mechanism from elsewhere should."""

from __future__ import annotations

import ast
import re
import runpy
import shlex
from pathlib import Path

import click
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hhtbench as hb
from hhtbench.campaign import analysis
from hhtbench.cli.main import main
from tests.eventful.test_switches import stick_slip
from tests.sample import slow

mpl.use("agg")
DOCS = Path(__file__).parent.parent / "docs"
PAGES = sorted(DOCS.glob("*.md"))
COMMANDS = sorted(
    {line for file in PAGES for line in re.findall(r"^hhtbench .*$", file.read_text(encoding="utf-8"), re.MULTILINE)}
)

SCRIPTS = sorted(file.name for file in (DOCS / "gallery").glob("plot_*.py"))
LONG = ("plot_06_chain.py", "plot_08_redundant.py", "plot_09_compare.py")  # 4 to 5 s each


def run_page(name):
    """All Python blocks of a page, one after the other; what they define."""
    scope: dict = {}
    for block in re.findall(r"```python\n(.*?)```", (DOCS / name).read_text(encoding="utf-8"), re.DOTALL):
        exec(compile(block, name, "exec"), scope)
    return scope


def text_of(file):
    return file.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def rk4():
    return run_page("write_a_solver.md")["RK4"]()


def test_every_page_has_code_that_is_run():
    run_here = set(re.findall(r'run_page\("([\w.]+)"\)', text_of(Path(__file__))))
    elsewhere = {"mechanisms.md", "files.md", "advice.md"}  # in tests/mechanics and tests/advice
    assert {file.name for file in PAGES if "```python" in text_of(file)} == run_here | elsewhere


@pytest.mark.parametrize("file", [file for file in PAGES if file.name != "readme.md"], ids=lambda file: file.name)
def test_every_page_begins_with_what_its_reader_can_do_and_is_in_the_index(file):
    heading, _, first, *_ = text_of(file).splitlines()
    assert heading.startswith("# ")
    assert first.startswith("After this page you ")
    assert f"   {file.stem}\n" in text_of(DOCS / "index.rst")


def test_pages_are_short():
    prose = [re.sub(r"```.*?```", "", text_of(file), flags=re.DOTALL) for file in PAGES]
    assert sum(len(text.split()) for text in prose) <= 9000  # code aside


@pytest.mark.parametrize(
    "file", [*PAGES, DOCS.parent / "README.md", DOCS.parent / "CONTRIBUTING.md"], ids=lambda file: file.name
)
def test_every_link_to_a_file_leads_somewhere(file):
    for target, anchor in re.findall(r"\]\((?!https?:)([^)#]*)(?:#([^)]*))?\)", text_of(file)):
        found = file.parent / target if target else file
        assert found.exists(), target
        if anchor:
            headings = [
                re.sub(r"[^\w -]", "", line).strip().lower().replace(" ", "-") for line in text_of(found).splitlines()
            ]
            assert anchor in headings, f"{target}#{anchor}"


@pytest.mark.parametrize("line", COMMANDS)
def test_every_command_of_the_pages_exists_with_its_options(line):
    name, *arguments = shlex.split(line, comments=True)[1:]
    command = main.commands[name]
    if isinstance(command, click.Group):
        name, *arguments = arguments
        command = command.commands[name]
    command.make_context(name, arguments, resilient_parsing=True)


def test_the_rope_of_the_first_page_carries_the_load_at_the_start(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    scope = run_page("getting_started.md")
    assert scope["solution"].success
    assert scope["solution"].error.bound < 1e-3
    np.testing.assert_allclose(scope["tension"][0], 49.05, rtol=1e-6)


def test_the_pin_of_the_page_carries_a_quarter_of_the_weight_and_then_two_and_a_half_times_it(capsys):
    scope, weight = run_page("joint_forces.md"), 2.0 * 9.81
    force = scope["force"]
    np.testing.assert_allclose(force[0], [0.0, weight / 4], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(force, axis=1).max(), 2.5 * weight, rtol=1e-4)
    rows, means, damped_rows, damped_means = [float(x) for x in re.findall(r"([\d.]+) of 9", capsys.readouterr().out)]
    assert means < rows / 4  # a fifth
    assert damped_means < damped_rows < rows / 4


def test_the_bead_of_the_page_moves_as_its_equation_of_the_angle_says(capsys):
    def sliding(t, y):  # from the lowest point; the ring's force a kilogram is cos(angle) g + rate^2
        across = 9.81 * np.cos(y[0]) + y[1] ** 2
        return [y[1], -9.81 * np.sin(y[0]) - 0.15 * abs(across) * np.tanh(y[1] / 0.02)]

    run_page("friction.md")
    angle = solve_ivp(sliding, (0.0, 3.0), [np.pi / 2, 0.0], "LSODA", rtol=1e-9, atol=1e-11).y[0, -1]
    for shown in re.findall(r"\[(.*?)\]", capsys.readouterr().out)[-2:]:
        np.testing.assert_allclose([float(x) for x in shown.split()], [np.sin(angle), -np.cos(angle)], atol=2e-4)


def test_the_ball_of_the_page_bounces_when_free_fall_says(capsys):
    scope, fall = run_page("events.md"), np.sqrt(2 / 9.81)
    found = scope["solution"]
    np.testing.assert_allclose(found.t_events[0], [fall, 2 * fall, 2.5 * fall], atol=1e-6)
    np.testing.assert_allclose(found.t_events[1], [1.5 * fall, 2.25 * fall, 2.625 * fall], atol=1e-6)
    rest, slipped = scope["rest"], scope["slipped"]
    assert rest.phases[1].t == pytest.approx(3 * fall, abs=1e-2)
    assert rest.lam[-1, 0] == pytest.approx(-9.81)
    np.testing.assert_allclose(scope["train"].v[-1], 1.0, rtol=1e-12)
    np.testing.assert_allclose(abs(scope["train"].impacts[0].lam), 2000.0)
    (breaks, sticks) = stick_slip(2)
    np.testing.assert_allclose(slipped.t_events[0][:2], breaks, atol=1e-6)
    np.testing.assert_allclose(slipped.t_events[1][:2], sticks, atol=1e-6)


def test_the_cart_and_the_slider_of_the_page_move_as_integrations_of_their_own_say(capsys):
    scope = run_page("control.md")
    gains, y, pull = scope["GAINS"], np.array([0.0, 0.2, 0.0, 0.0]), 0.0

    def cart(t, y, pull):
        (speed, rate), (s, c) = y[2:], (np.sin(y[1]), np.cos(y[1]))
        matrix, force = [[1.2, 0.1 * c], [c, 0.5]], [pull + 0.1 * rate**2 * s, 9.81 * s]
        return [speed, rate, *np.linalg.solve(matrix, force)]

    for _ in range(300):
        sampled = gains @ y
        for length, acting in ((0.004, pull), (0.006, sampled)):
            y = solve_ivp(cart, (0, length), y, args=(acting,), rtol=1e-9, atol=1e-11).y[:, -1]
        pull = sampled
    np.testing.assert_allclose(scope["solution"].q[-1, :2], [y[0], y[0] + 0.5 * np.sin(y[1])], atol=1e-4)

    def slider(t, y):
        x, v, z = y
        rate = v - abs(v) * z * 1e5 / (1.0 + 0.5 * np.exp(-((v / 1e-3) ** 2)))
        return [v, 2.0 * (0.1 * t - x) - 1e5 * z - 1e5**0.5 * rate - 0.4 * v, rate]

    x, v, z = solve_ivp(slider, (0, 20), [0, 0, 0], "Radau", rtol=1e-9, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(scope["slid"].q[-1, 0], x, atol=1e-3)
    np.testing.assert_allclose(scope["slid"].v[-1] / [1e-1, 1e-5], [v / 1e-1, z / 1e-5], atol=1e-2)

    y, torque = np.zeros(2), 0.0
    for _ in range(200):
        wanted = 10 * (1 - y[0]) - 3 * y[1]

        def arm(t, x, wanted=wanted):
            return [x[1], (-9.81 * np.sin(x[0]) + x[2]) / 0.6, 5 * (wanted - x[2])]

        *y, torque = solve_ivp(arm, (0, 0.01), [*y, torque], rtol=1e-9, atol=1e-11).y[:, -1]
    found = [scope["m"].of(scope["run"], "A").angle(), scope["m"].of(scope["run"], "torque").value() / 10]
    np.testing.assert_allclose([x[-1] for x in found], [y[0], torque / 10], atol=1e-4)


def test_external_code_moves_as_the_pendulum_of_the_library_form(capsys):
    run_page("external_code.md")
    angle = solve_ivp(lambda t, y: [y[1], -9.81 * np.cos(y[0])], (0, 1), [0, 0], rtol=1e-10, atol=1e-12).y[0, -1]
    for shown in re.findall(r"\[(.*?)\]", capsys.readouterr().out):
        np.testing.assert_allclose([float(x) for x in shown.split()], [np.cos(angle), np.sin(angle)], atol=1e-5)


def test_pendulums_of_the_sweep_swing_down_to_their_lengths(capsys):
    heights = run_page("sweeps.md")["heights"]
    assert len(heights) == 11
    for length, lowest in heights.items():
        np.testing.assert_allclose(lowest, -length, rtol=1e-3)


def test_a_restart_goes_on_bit_by_bit(capsys):
    run_page("restart.md")
    assert capsys.readouterr().out.startswith("True")


def test_the_pages_on_the_integrator_and_on_notebooks_run(capsys):
    assert run_page("integrator.md")["solution"].success
    run_page("jupyter.md")
    assert "lam[0]" in capsys.readouterr().out


@pytest.mark.parametrize("script", [slow(x) if x in LONG else x for x in SCRIPTS])
def test_every_script_of_the_gallery_draws_a_finite_picture(script, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    plt.close("all")
    runpy.run_path(str(DOCS / "gallery" / script))
    lines = [line for axes in plt.gcf().axes for line in axes.get_lines()]
    assert lines
    assert all(np.isfinite(np.asarray(line.get_ydata(), dtype=float)).any() for line in lines)
    told = capsys.readouterr().out
    assert told
    assert "failed" not in told
    plt.close("all")


@pytest.mark.parametrize("name", ["jay_negrut_pendulum", "knife_edge", "rolling_disk3d_steady"])
def test_the_solver_of_the_page_has_order_four_in_rows_and_multipliers(rk4, name):
    problem = hb.load_problem(name)
    t0, t1 = problem.t_span[0], problem.t_span[0] + min(1.0, problem.t_span[1] - problem.t_span[0])
    short = hb.Problem(**{**vars(problem), "t_span": (t0, t1), "reference": None, "exact": None})
    asked = {"t_eval": np.linspace(t0, t1, 8)}
    true = hb.solve(short, "projected", rtol=1e-12, **asked)
    errors = []
    for steps in (50, 100, 200):
        found = hb.solve(short, rk4, steps=steps, **asked)
        pairs = [(found.q, true.q), (found.v, true.v), (found.lam, true.lam), (found.mu, true.mu)]
        errors.append([np.max(np.abs(a - b), initial=0.0) for a, b in pairs])
    errors = np.array(errors)[:, np.array(errors[-1]) > 1e-11]  # of what a problem has, above roundoff
    assert errors.size
    np.testing.assert_allclose(np.log2(errors[:-1] / errors[1:]), 4.0, atol=0.5)


def test_redundant_rows_are_left_out_and_multipliers_are_those_of_least_norm(rk4):
    found = hb.solve("redundant_pendulum", rk4, steps=2000, t_eval=[1.0])
    with pytest.warns(UserWarning, match="redundant"):
        true = hb.solve("redundant_pendulum", "projected", rtol=1e-10, t_eval=[1.0])
    assert found.lam.shape == (1, 2)
    np.testing.assert_allclose(found.lam, true.lam, rtol=1e-5)


def test_the_solver_of_the_page_is_that_which_is_held_to_all_checks():
    """As an installed distribution: budgets, values that are not finite, motions back in time and all else."""
    (held,) = Path(__file__).parent.glob("*/acme_rk4/acme_rk4.py")
    page = re.search(r"class RK4:.*?(?=\n\n\n)", (DOCS / "write_a_solver.md").read_text(encoding="utf-8"), re.DOTALL)
    shown, checked = (ast.parse(re.sub(r"\b(acme_)?rk4\b", "rk4", text)) for text in (page[0], held.read_text()))
    assert ast.dump(shown.body[0]) == ast.dump(checked.body[-1])


def test_rows_that_do_not_fit_are_refused():
    equations = hb.Equations(hb.load_problem("simple_pendulum"))
    with pytest.raises(hb.ProblemError, match=r"shapes \(k,\), \(k, 2\), \(k, 2\); got \(3,\), \(3, 1\), \(3, 2\)"):
        equations.solution(np.zeros(3), np.zeros((3, 1)), np.zeros((3, 2)))


def test_both_levels_are_those_of_the_constraints():
    equations = hb.Equations(hb.load_problem("simple_pendulum"))  # a rod of length one
    position, velocity = equations.constraints(0.0, np.array([2.0, 0.0]), np.array([3.0, 0.0]))
    assert (equations.n, equations.m, equations.p) == (2, 1, 0)
    assert abs(position[0]) > 0.5
    assert abs(velocity[0]) > 0.5
    assert np.all(equations.constraints(0.0, np.array([0.0, 1.0]), np.array([3.0, 0.0]))[1] == 0.0)


def test_the_checks_of_the_page_pass(capsys):
    found = run_page("check_a_solver.md")["found"]
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("position/")]
    assert len(lines) > 5
    assert {line.split()[1] for line in lines} <= {"right", "declined"}
    assert 0 < found.spread < 1e-2


def test_the_mechanism_of_the_page_moves_as_its_equation_in_one_coordinate_says(capsys):
    scope = run_page("write_a_problem.md")
    assert "claims hold" in capsys.readouterr().out
    found, g, length = scope["solution"], 9.81, 1.5

    def falling(t, y):  # angle'' = -3 g cos(angle) / (2 length), while both ends touch
        return [y[1], -1.5 * g * np.cos(y[0]) / length]

    angle = solve_ivp(falling, (0.0, 0.4), [1.2, 0.0], rtol=1e-11, atol=1e-12).y[0, -1]
    np.testing.assert_allclose(found.q[-1, 2], angle, atol=1e-5)


def test_the_fit_of_the_page_is_the_least_squares_solution_and_finds_the_parameters(capsys):
    """Gauss and Newton's next step by another model, the rope's angle in the place of the load's position."""
    scope = run_page("fits.md")
    x, measured, times = scope["x"], scope["measured"], scope["times"]

    def misfit(p):
        def moving(t, y):  # trolley and angle, and their rates
            (trolley, load, rope), (_, angle, speed, rate) = p, y
            s, c = np.sin(angle), np.cos(angle)
            mass = [[trolley + load, load * rope * c], [c, rope]]
            force = [50.0 * np.sin(t) - 10.0 * speed + load * rope * rate**2 * s, -9.81 * s]
            return [speed, rate, *np.linalg.solve(mass, force)]

        y = solve_ivp(moving, (0.0, 10.0), np.zeros(4), "DOP853", times, rtol=1e-10, atol=1e-11).y
        return (np.stack([y[0], y[0] + p[2] * np.sin(y[1])], axis=1) - measured).ravel()

    left = misfit(x)
    slopes = np.stack([(misfit(x + d) - misfit(x - d)) / 2e-3 for d in 1e-3 * np.eye(3)], axis=1)
    deviations = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)) * (left @ left) / (left.size - 3))
    further = np.linalg.lstsq(slopes, -left)[0]
    assert np.max(np.abs(further / deviations)) < 0.05
    assert np.max(np.abs(x - [20.0, 5.0, 3.7]) / deviations) < 3.0
    np.testing.assert_allclose(scope["deviations"], deviations, rtol=0.01)


@pytest.mark.long  # README runs a campaign, too
def test_the_campaign_of_the_page_reaches_its_errors_and_tells_costs(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    scope = run_page("campaigns.md")
    told = capsys.readouterr().out
    assert all(row["status"] == "success" for row in scope["runs"].table())
    assert all(f"{solver:16}" in told for solver in ("hht", "ida(form=ggl)", "projected"))
    assert (tmp_path / "runs.csv").read_text().count("\n") == len(scope["runs"].rows) + 1
    text = (DOCS / "campaigns.md").read_text(encoding="utf-8")
    assert all(name in analysis.__all__ for name in re.findall(r"`(\w+)\(rows", text))
