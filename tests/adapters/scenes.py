"""One small scene per kind of constraint, each with a closed solution, and every solver and form."""

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.system import NumpySystem, System, parameter
from hhtbench.solution.request import Request
from solvers import cvode, diffrax_ode, ida, projected, scipy_ivp

OMEGA = 1.5  # angular velocity of the scenes on a circle [rad/s]
GROWTH = 0.3  # of the rheonomic circle's radius [m/s]
ALL = [
    *(ida.solver(form=form) for form in ("ggl", "index1", "integrated", "index2")),
    *(cvode.solver(method=method) for method in ("bdf", "adams")),
    *(scipy_ivp.solver(method=method) for method in ("Radau", "BDF", "LSODA", "DOP853")),
    *(projected.solver(engine=engine) for engine in ("compiled", "python")),
    *(diffrax_ode.solver(method=method) for method in ("Tsit5", "Dopri8", "Kvaerno5")),
]
HOST = [solver for solver in ALL if solver.library != "diffrax"]  # the loop is in Python and callbacks are plain calls
TSIT5 = diffrax_ode.solver(method="Tsit5")
ON_HOST, EVERY = (
    pytest.mark.parametrize("solver", solvers, ids=lambda solver: solver.name) for solvers in (HOST, [*HOST, TSIT5])
)
LOOSE = Request(rtol=1e-6)


def circle(t, q, radius=1.0):
    return jnp.stack([(q[0] ** 2 + q[1] ** 2 - radius**2) / 2])


class Ring(System):
    """A bead on a fixed circle: it goes round at constant speed."""

    def force(self, t, q, v):
        return jnp.zeros(2)

    def constraint(self, t, q):
        return circle(t, q)


class Growing(Ring):
    """The circle grows: the moment of momentum is kept."""

    growth: object = parameter(GROWTH, doc="[m/s]")

    def constraint(self, t, q):
        return circle(t, q, 1.0 + self.growth * t)


class Heavy(Ring):
    """The mass depends on the place; it is in the multiplier alone."""

    def mass_matrix(self, t, q):
        return (2.0 + q[0]) * jnp.eye(2)


class Squared(Ring):
    """A reaction nonlinear in lam, with a second root that a wrong guess would lead to."""

    def reaction(self, t, q, lam):
        return -q * (lam[0] + lam[0] ** 2)


class Screw(System):
    """A nut turned by a velocity constraint, v_z = the turning rate, on a circle: accelerated by 1 rad/s^2."""

    def force(self, t, q, v):
        return jnp.array([0.0, 0.0, 2.0])

    def constraint(self, t, q):
        return circle(t, q)

    def velocity_constraint(self, t, q, v):
        return jnp.stack([v[2] + q[1] * v[0] - q[0] * v[1]])


class Skate(System):
    """A plate that slides along its edge only, on a slope, and turns steadily."""

    def force(self, t, q, v):
        return jnp.array([2.0, 0.0, 0.0])

    def velocity_constraint(self, t, q, v):
        return jnp.stack([v[0] * jnp.sin(q[2]) - v[1] * jnp.cos(q[2])])


class Spring(System):
    """No constraint."""

    def force(self, t, q, v):
        return -4.0 * q


def on_circle(phi, omega, acceleration, radius=1.0, speed=0.0):
    """q and v of a point at the angle ``phi``, for a circle whose radius changes with ``speed``."""
    normal, along = np.array([np.cos(phi), np.sin(phi)]), np.array([-np.sin(phi), np.cos(phi)])
    return radius * normal, speed * normal + radius * omega * along


def ring(t, multiplier=OMEGA**2):
    return Motion(*on_circle(OMEGA * t, OMEGA, 0.0), np.array([multiplier]), np.zeros(0))


def growing(t):
    radius = 1 + GROWTH * t
    omega = OMEGA / radius**2
    return Motion(*on_circle(OMEGA * t / radius, omega, 0.0, radius, GROWTH), np.array([omega**2]), np.zeros(0))


def heavy(t):
    return ring(t, OMEGA**2 * (2 + np.cos(OMEGA * t)))


def squared(t):
    return ring(t, np.sqrt(0.25 + OMEGA**2) - 0.5)


def screw(t):
    phi, omega = OMEGA * t + t**2 / 2, OMEGA + t
    q, v = on_circle(phi, omega, 1.0)
    return Motion(np.append(q, phi), np.append(v, omega), np.array([omega**2]), np.array([1.0]))


def skate(t):
    """The speed along the edge obeys u' = 2 cos(OMEGA t)."""
    phi = OMEGA * t
    u = 2 * np.sin(phi) / OMEGA
    q = np.array([np.sin(phi) ** 2, phi - np.sin(phi) * np.cos(phi), OMEGA**2 * t]) / OMEGA**2
    # across the edge: u phi' = 2 * (-sin phi) - mu * (-1)
    return Motion(
        np.append(q[:2], phi),
        np.array([u * np.cos(phi), u * np.sin(phi), OMEGA]),
        np.zeros(0),
        np.array([u * OMEGA + 2 * np.sin(phi)]),
    )


def spring(t):
    return Motion(np.array([np.cos(2 * t)]), np.array([-2 * np.sin(2 * t)]), np.zeros(0), np.zeros(0))


KINDS = {
    "position": (Ring(), ring),
    "rheonomic": (Growing(), growing),
    "variable mass": (Heavy(), heavy),
    "nonlinear reaction": (Squared(), squared),
    "mixed": (Screw(), screw),
    "velocity": (Skate(), skate),
    "unconstrained": (Spring(), spring),
}


def problem(kind="position", t_span=(0.0, 1.0), system=None, **more):
    default, exact = KINDS[kind]
    start = exact(t_span[0])
    return Problem(
        name=kind,
        system=system or default,
        t_span=t_span,
        q0=start.q,
        v0=start.v,
        lam_guess=start.lam if start.lam.size else None,
        exact=exact,
        **more,
    )


RING = {
    "force": lambda t, q, v: np.zeros(2),
    "force_jacobians": lambda t, q, v: (np.zeros((2, 2)), np.zeros((2, 2))),
    "constraint": lambda t, q: np.array([(q @ q - 1.0) / 2]),
    "constraint_jacobian": lambda t, q: np.array([[q[0], q[1]]]),
    "constraint_time_derivative": lambda t, q: np.zeros(1),
    "constraint_acceleration": lambda t, q, v: np.array([v @ v]),
}


def numpy_ring(t_span=(0.0, 1.0), **changes):
    """The bead on the fixed circle as plain callables, some of them replaced."""
    return problem(t_span=t_span, system=NumpySystem(**{**RING, **changes}))


def errors(solution, exact):
    """Largest error over all rows of q, v and of both multipliers."""
    motions = [exact(t) for t in solution.t]
    return tuple(
        max((np.max(np.abs(np.asarray(getattr(m, name)) - row), initial=0.0) for m, row in zip(motions, rows, strict=True)))
        for name, rows in (("q", solution.q), ("v", solution.v), ("lam", solution.lam), ("mu", solution.mu))
    )
