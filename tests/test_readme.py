"""What README shows runs, and its mechanism moves as an independent integration says."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")


def example() -> str:
    block = re.search(r"```python\n(.*?)```", README, re.DOTALL)
    assert block, "README has no Python example"
    return block.group(1)


def test_every_example_runs_one_after_the_other(capsys):
    scope: dict = {}
    for block in re.findall(r"```python\n(.*?)```", README, re.DOTALL):
        exec(compile(block, "README.md", "exec"), scope)
        assert scope["solution"].success
    assert "steps_accepted" in capsys.readouterr().out


def test_the_example_defines_a_mechanism_in_about_twenty_lines():
    code = [line for line in example().splitlines() if line.strip()]
    assert len(code) <= 24


def test_the_example_agrees_with_minimal_coordinates(capsys):
    scope: dict = {}
    exec(compile(example(), "README.md", "exec"), scope)
    solution = scope["solution"]
    assert solution.success
    assert "claims hold" in capsys.readouterr().out

    trolley, load, rope, gravity = 20.0, 5.0, 4.0, 9.81

    def rhs(t, y):
        """Trolley x and rope angle from the vertical (Lagrange, by hand)."""
        _, angle, u, w = y
        s, c = np.sin(angle), np.cos(angle)
        mass = np.array([[trolley + load, load * rope * c], [c, rope]])
        force = np.array([50.0 * np.sin(t) - 10.0 * u + load * rope * s * w**2, -gravity * s])
        return [u, w, *np.linalg.solve(mass, force)]

    x, angle = solve_ivp(rhs, (0, 10), [0, 0, 0, 0], rtol=1e-11, atol=1e-12, method="DOP853").y[:2, -1]
    expected = [x, x + rope * np.sin(angle), -rope * np.cos(angle)]
    np.testing.assert_allclose(solution.q[-1], expected, atol=2e-3)  # rtol = 1e-4 of coordinates of 7 m
    coarse, fine = (scope["hb"].solve(scope["crane"], "hht(alpha=-0.1)", step=h) for h in (0.01, 0.005))
    extrapolated = (4 * fine.q[-1] - coarse.q[-1]) / 3  # removes the O(h^2) error
    np.testing.assert_allclose(extrapolated, expected, atol=5e-6)
