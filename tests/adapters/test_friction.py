"""Friction in a two-sided joint, Coulomb's law smoothed in v: every form's motion is that of the angle alone."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hhtbench as hb
from hhtbench.protocol.system import NumpySystem
from hhtbench.solution.result import Status

GRAVITY, MU, SLIP, END = 9.81, 0.2, 0.1, 1.0


def ring(xp, t, q):
    return xp.stack([(q[0] ** 2 + q[1] ** 2 - 1.0) / 2.0])


def dry(xp, t, q, v, lam):
    """Normal force and friction; lam changes its sign where the bead changes the side of the ring that carries it."""
    along = xp.stack([-q[1], q[0]])
    return -lam[0] * q - MU * xp.abs(lam[0]) * xp.tanh((along @ v) / SLIP) * along


class Bead(hb.System):
    """Unit mass on a ring of radius 1 m in a vertical plane."""

    def force(self, t, q, v):
        return jnp.array([0.0, -GRAVITY])

    def constraint(self, t, q):
        return ring(jnp, t, q)

    def reaction(self, t, q, v, lam):
        return dry(jnp, t, q, v, lam)


JAX = Bead()
NUMPY = NumpySystem(
    force=lambda t, q, v: np.array([0.0, -GRAVITY]),
    constraint=lambda t, q: ring(np, t, q),
    constraint_jacobian=lambda t, q: q[None],
    reaction=lambda t, q, v, lam: dry(np, t, q, v, lam),
)
ANGLE, RATE = 2.0, -2.5  # above the centre, where gravity pushes the bead inwards, less and less as it gets faster


def problem(system):
    q = np.array([np.cos(ANGLE), np.sin(ANGLE)])
    return hb.Problem(name="dry bead", system=system, t_span=(0.0, END), q0=q, v0=RATE * np.array([-q[1], q[0]]))


@pytest.fixture(scope="module")
def end():
    """q, v, lam at the end, from the angle's equation: the ring holds the bead by u^2 - g sin(angle)."""

    def rate(t, y):
        normal = y[1] ** 2 - GRAVITY * np.sin(y[0])
        return [y[1], -GRAVITY * np.cos(y[0]) - MU * abs(normal) * np.tanh(y[1] / SLIP)]

    motion = solve_ivp(rate, (0.0, END), [ANGLE, RATE], "DOP853", rtol=1e-13, atol=1e-13)
    normal = motion.y[1] ** 2 - GRAVITY * np.sin(motion.y[0])
    assert normal.min() < 0.0 < normal.max()  # both sides carry
    angle, speed = motion.y[:, -1]
    q = np.array([np.cos(angle), np.sin(angle)])
    return {"q": q, "v": speed * np.array([-q[1], q[0]]), "lam": normal[-1:]}


SOLVERS = ["ida", "ida(form=index1)", "cvode", "scipy(method=Radau)", "scipy(method=DOP853)", "projected"]
CASES = [
    ("hht", JAX),
    *((solver, JAX) for solver in SOLVERS),
    *((solver, NUMPY) for solver in ("ida", "cvode", "projected")),
]


@pytest.mark.parametrize(("solver", "system"), CASES, ids=lambda x: x if isinstance(x, str) else type(x).__name__)
def test_every_form_of_friction_is_the_motion_of_the_angle(end, solver, system):
    solution = hb.solve(problem(system), solver, rtol=1e-6 if solver == "hht" else 1e-8)
    assert solution.success, solution.message
    for name, wanted in end.items():
        np.testing.assert_allclose(getattr(solution, name)[-1], wanted, rtol=2e-5, atol=2e-5)


def test_diffrax_takes_friction_nonlinear_in_lam(end):
    solution = hb.solve(problem(JAX), "diffrax(method=Tsit5)", rtol=1e-6)
    assert solution.success, solution.message
    np.testing.assert_allclose(solution.q[-1], end["q"], atol=2e-5)


class TwoRoots(Bead):
    """Quadratic in lam: from no multipliers Newton's iteration goes to the root near it."""

    def reaction(self, t, q, v, lam):
        return -q * (lam[0] + lam[0] ** 2) - 0.1 * lam[0] * v


def test_an_ode_that_finds_another_root_than_the_start_says_so():
    """u^2 - g sin(angle) = lam + lam^2 at the lowest point, at 2 m/s, has a root below -1 too."""
    other = -0.5 - np.sqrt(0.25 + 4.0 + GRAVITY)
    given = hb.Problem(name="two roots", system=TwoRoots(), t_span=(0.0, 0.5), q0=[0, -1], v0=[2, 0], lam_guess=[other])
    assert hb.solve(given, "hht", rtol=1e-4).success
    solution = hb.solve(given, "scipy(method=DOP853)", rtol=1e-4)
    assert solution.status is Status.newton_failed
    assert "finds others than those of the start" in solution.message
