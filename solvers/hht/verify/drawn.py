"""Scenes drawn by a seed: masses on rods, and what is known of them without the integrator."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.protocol import Problem, Scales, System, parameter
from hhtbench.request import Request
from solvers.projected import solver as projected

GRAVITY = 9.81  # [m/s^2]
MASSES, LENGTHS = (0.3, 2.0), (0.3, 1.0)  # [kg], [m]: what is drawn lies between
T_END, ROWS = 2.0, 41  # [s], before chains part from one another; rows of a known motion


class Beads(System):
    """``q`` (k d,): k point masses, each on a rod from the one before it, the first from the origin; d is 2 or 3."""

    mass: Any = parameter(doc="(k,) [kg]")
    length: Any = parameter(doc="of each rod, (k,) [m]")
    g: Any = parameter(GRAVITY, doc="gravity [m/s^2]")
    dimension: int = eqx.field(static=True, default=2)

    @property
    def mass_matrix(self) -> Any:
        """Diagonal (k d,) [kg]."""
        return jnp.repeat(self.mass, self.dimension)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Weight, (k d,) [N]."""
        down = jnp.zeros(self.dimension).at[-1].set(-self.g)
        return jnp.outer(self.mass, down).ravel()

    def constraint(self, t: Any, q: Any) -> Any:
        """(k,) [m^2]."""
        places = q.reshape(-1, self.dimension)
        rods = places - jnp.concatenate([jnp.zeros((1, self.dimension)), places[:-1]])
        return (jnp.sum(rods * rods, axis=1) - self.length**2) / 2

    def energies(self, q: Matrix, v: Matrix) -> Vector:
        """Kinetic energy and height (r,) [J] of the rows of ``q`` and ``v`` (r, k d)."""
        mass = np.asarray(self.mass)
        height = q[:, self.dimension - 1 :: self.dimension] @ mass
        return v**2 @ np.repeat(mass, self.dimension) / 2 + GRAVITY * height


def drawn(seed: int, count: int, dimension: int = 2, spin: float = 0.0) -> Problem:
    """``count`` masses on rods in every direction, turning at rates of ``spin`` times a normal number [rad/s].

    Known by rows of an explicit method of order eight on the underlying ODE.
    """
    random = np.random.default_rng(seed)
    mass, length = random.uniform(*MASSES, count), random.uniform(*LENGTHS, count)
    rods = random.normal(size=(count, dimension))
    rods /= np.linalg.norm(rods, axis=1)[:, None]
    rates = random.normal(size=(count, dimension))
    rates -= np.sum(rates * rods, axis=1)[:, None] * rods
    speed = float(np.sqrt(GRAVITY * length.sum()))
    problem = Problem(
        name=f"drawn {seed}: {count} {'mass' if count == 1 else 'masses'} in {dimension} dimensions, spin {spin:g}",
        system=Beads(mass=mass, length=length, dimension=dimension),
        t_span=(0.0, T_END),
        q0=np.cumsum(length[:, None] * rods, axis=0).ravel(),
        v0=np.cumsum(spin * length[:, None] * rates, axis=0).ravel(),
        scales=Scales(q=float(length.sum()), v=speed, lam=GRAVITY),
    )
    times = np.linspace(*problem.t_span, ROWS)
    found = projected(method="DOP853").solve(problem, Request(rtol=1e-12, atol=1e-13, t_eval=times))
    if not found.success:
        raise RuntimeError(f"{problem.name}: no reference: {found.message}")
    return replace(problem, reference={"t": found.t, "q": found.q, "v": found.v})


def hanging(seed: int, count: int) -> tuple[Beads, Vector, Vector, Matrix]:
    """A drawn chain at rest below the origin: system, q0, frequencies (k,) [rad/s] and modes (k, k) of the x coordinates.

    Small swings obey ``m_i x_i'' = -T_i (x_i - x_(i-1)) / l_i + T_(i+1) (x_(i+1) - x_i) / l_(i+1)`` with T the weight below.
    """
    random = np.random.default_rng(seed)
    mass, length = random.uniform(*MASSES, count), random.uniform(*LENGTHS, count)
    pull = GRAVITY * np.cumsum(mass[::-1])[::-1] / length
    stiffness = np.diag(pull + np.append(pull[1:], 0.0)) - np.diag(pull[1:], 1) - np.diag(pull[1:], -1)
    squares, modes = np.linalg.eig(stiffness / mass[:, None])
    order = np.argsort(squares.real)
    q0 = np.column_stack([np.zeros(count), -np.cumsum(length)]).ravel()
    return Beads(mass=mass, length=length), q0, np.sqrt(squares.real[order]), modes.real[:, order]
