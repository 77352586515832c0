"""Between rows that fit the motion before and after: a force that no row knows of, a leap.  Small multipliers, too."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hhtbench import NumpySystem, Problem, Request, Solution, Status
from hhtbench.checks.result.judge import judge

T = np.linspace(0.0, 10.0, 51)
PUSHED, WIDTH = 6.317, 0.02  # between the rows at 6.2 and 6.4: e^-27 of the push is left there
ASKED = Request(rtol=1e-6, t_eval=T)


def pushed(push: float) -> Problem:
    """A mass on a spring that is pushed for a moment."""

    def force(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.asarray(push * np.exp(-(((t - PUSHED) / WIDTH) ** 2)) - q)

    return Problem(name="pushed", system=NumpySystem(force=force), t_span=(0.0, 10.0), q0=[1.0], v0=[0.0])


def told(y: np.ndarray) -> Solution:
    """Rows y = [q, v] (51, 2) at ``T``."""
    none: Any = np.zeros((T.size, 0))
    return Solution(t=T, q=y[:, :1], v=y[:, 1:], lam=none, mu=none, status=Status.success, message="there")


def swing(t: np.ndarray) -> np.ndarray:
    return np.column_stack([np.cos(t), -np.sin(t)])


@pytest.mark.parametrize(("push", "rtol"), [(5.0, 1e-6), (40.0, 1e-2)])
def test_a_force_that_begins_and_ends_between_two_rows_is_not_missed(push: float, rtol: float):
    problem, asked = pushed(push), replace(ASKED, rtol=rtol)
    rates = lambda t, y: [y[1], problem.system.force(t, y[0], y[1])]  # type: ignore[union-attr]  # noqa: E731
    true = solve_ivp(rates, (0.0, 10.0), [1.0, 0.0], t_eval=T, rtol=1e-10, atol=1e-10, max_step=0.01)
    assert judge(problem, asked, told(true.y.T)).doubt == ""
    for draw in range(2):
        found = judge(problem, asked, told(swing(T)), draw=draw)
        assert found.doubt.startswith("equations of motion: from the row at t = 6.2")


@pytest.mark.parametrize("draw", range(2))
def test_a_leap_to_a_motion_beside_is_found(draw: int):
    """In q and v both: the velocities leave less of it than of the way to any next row."""
    after = T[:, None] > 6.3
    found = judge(pushed(0.0), ASKED, told(swing(T) + 1e-3 * after * swing(T - 6.3)), draw=draw)
    assert found.doubt.startswith("equations of motion: from the row at t = 6.2")


def test_multipliers_of_a_light_body_are_no_part_of_a_heavy_ones():
    """Bobs of 1 kg and 1 g on circles of 1 m at 1 rad/s, without weight."""
    mass = np.array([1.0, 1.0, 1e-3, 1e-3])
    pairs = np.kron(np.eye(2), np.ones(2))
    system = NumpySystem(
        mass_matrix=lambda t, q: np.diag(mass),
        force=lambda t, q, v: 0.0 * q,
        constraint=lambda t, q: pairs @ q**2 - 1.0,
        constraint_jacobian=lambda t, q: 2.0 * pairs * q,
        constraint_acceleration=lambda t, q, v: 2.0 * pairs @ v**2,
    )
    t = np.linspace(0.0, 2.0, 11)
    q, v = (np.tile(x, 2) for x in (np.column_stack([np.cos(t), np.sin(t)]), np.column_stack([-np.sin(t), np.cos(t)])))
    problem = Problem(name="two bobs", system=system, t_span=(0.0, 2.0), q0=q[0], v0=v[0])
    lam = np.tile([0.5, 0.5e-3], (t.size, 1))
    made = Solution(t=t, q=q, v=v, lam=lam, mu=np.zeros((t.size, 0)), status=Status.success, message="there")
    asked = Request(rtol=1e-6, t_eval=t)
    assert judge(problem, asked, made).doubt == ""
    for rows in (slice(None), slice(7, 8)):
        other = lam.copy()
        other[rows, 1] *= -1.0
        assert judge(problem, asked, replace(made, lam=other)).doubt.startswith("multipliers: ")
