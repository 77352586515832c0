"""What the pages of docs/ show runs as printed, and does what a solver and a mechanism from elsewhere should."""

from __future__ import annotations

import ast
import re
import runpy
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hhtbench as hb
from hhtbench.campaign import analysis

mpl.use("agg")
DOCS = Path(__file__).parent.parent / "docs"


def run_page(name):
    """All Python blocks of a page, one after the other; what they define."""
    scope: dict = {}
    for block in re.findall(r"```python\n(.*?)```", (DOCS / name).read_text(encoding="utf-8"), re.DOTALL):
        exec(compile(block, name, "exec"), scope)
    return scope


@pytest.fixture(scope="module")
def rk4():
    return run_page("write_a_solver.md")["RK4"]()


def test_every_page_has_code_that_is_run():
    assert {file.name for file in DOCS.glob("*.md") if "```python" in file.read_text(encoding="utf-8")} == {
        *("check_a_solver.md", "write_a_solver.md", "write_a_problem.md", "campaigns.md", "fits.md"),
        "mechanisms.md",  # in tests/mechanics
        "advice.md",  # in tests/advice
    }


@pytest.mark.parametrize("script", sorted(file.name for file in (DOCS / "gallery").glob("plot_*.py")))
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


def test_the_campaign_of_the_page_reaches_its_errors_and_tells_costs(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    scope = run_page("campaigns.md")
    told = capsys.readouterr().out
    assert all(row["status"] == "success" for row in scope["runs"].table())
    assert all(f"{solver:16}" in told for solver in ("hht", "ida(form=ggl)", "projected"))
    assert (tmp_path / "runs.csv").read_text().count("\n") == len(scope["runs"].rows) + 1
    text = (DOCS / "campaigns.md").read_text(encoding="utf-8")
    assert all(name in analysis.__all__ for name in re.findall(r"`(\w+)\(rows", text))
