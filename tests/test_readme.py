"""What README shows runs as printed, and its mechanism moves as an independent integration says."""

from __future__ import annotations

import re
import shlex
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp

import hhtbench as hb
from hhtbench.cli.main import main

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
EXAMPLE, PRINTED = re.findall(r"```(?:python|text)\n(.*?)```", README, re.DOTALL)[:2]
COMMANDS = re.findall(r"^hhtbench .*$", README, re.MULTILINE)


def numbers(text: str) -> list[float]:
    return [float(x) for x in re.findall(r"-?\d+\.?\d*", text)]


@pytest.fixture(scope="module")
def example():
    """What the first block defines, and what it prints."""
    scope: dict = {"__name__": "__main__"}
    with redirect_stdout(StringIO()) as printed:
        exec(compile(EXAMPLE, "README.md", "exec"), scope)
    return scope, printed.getvalue()


def test_readme_is_short():
    assert len(README.splitlines()) <= 150
    assert len(README.split()) <= 1000
    assert sum(bool(line.strip()) for line in EXAMPLE.splitlines()) <= 15


def test_the_example_prints_what_readme_says(example):
    _, printed = example
    assert re.sub(r"-?\d+\.?\d*", "#", printed) == re.sub(r"-?\d+\.?\d*", "#", PRINTED)
    np.testing.assert_allclose(numbers(printed), numbers(PRINTED), rtol=2e-3)


def test_the_example_agrees_with_minimal_coordinates(example):
    scope, _ = example
    solution, trolley, load, rope, gravity = scope["solution"], 20.0, 5.0, 4.0, 9.81

    def rhs(t, y):
        """Trolley x and rope angle from the vertical (Lagrange, by hand)."""
        _, angle, u, w = y
        s, c = np.sin(angle), np.cos(angle)
        mass = np.array([[trolley + load, load * rope * c], [c, rope]])
        force = np.array([50.0 * np.sin(t) - 10.0 * u + load * rope * s * w**2, -gravity * s])
        return [u, w, *np.linalg.solve(mass, force)]

    y = solve_ivp(rhs, (0, 10), [0, 0, 0, 0], rtol=1e-11, atol=1e-12, method="DOP853").y[:, -1]
    x, angle, _, rate = y
    expected = [x, x + rope * np.sin(angle), -rope * np.cos(angle)]
    np.testing.assert_allclose(solution.q[-1], expected, atol=2e-3)  # rtol = 1e-4 of coordinates of 7 m
    pull = load * (gravity * np.cos(angle) + rope * rate**2 - rhs(10, y)[2] * np.sin(angle)) / rope  # Newton, along the rope
    np.testing.assert_allclose(solution.lam[-1], pull, rtol=2e-3)
    coarse, fine = (hb.solve(scope["crane"], "hht(alpha=-0.1)", step=h) for h in (0.01, 0.005))
    extrapolated = (4 * fine.q[-1] - coarse.q[-1]) / 3  # removes the O(h^2) error
    np.testing.assert_allclose(extrapolated, expected, atol=5e-6)


@pytest.mark.parametrize("command", [line for line in COMMANDS if "bushings" not in line], ids=lambda line: line.split()[1])
def test_every_command_ends_well(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "crane.py").write_text(EXAMPLE)
    found = CliRunner().invoke(main, shlex.split(command)[1:])
    assert found.exit_code == 0, found.output
    if command.split()[1] == "run":
        summary = CliRunner().invoke(main, ["report", "--store", "crane.sqlite"])
        assert summary.exit_code == 0, summary.output
        assert "hht" in summary.output


def test_the_bushings_of_readme_pass_their_checks_and_move_alike_by_two_families():
    problem = hb.load_problem(str(Path(__file__).parent.parent / "docs/scenes/bushings.py") + ":problem")
    assert hb.check(problem).passed
    ours, theirs = (hb.solve(problem, name, rtol=1e-5, t_span=(0, 0.2)) for name in ("hht", "scipy(method=Radau)"))
    np.testing.assert_allclose(ours.q[-1], theirs.q[-1], atol=5e-4)
