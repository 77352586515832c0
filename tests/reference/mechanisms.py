"""Scenes without a known truth: bars on bushings, a crane whose trolley follows a table of positions, a guide that turns."""

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.mechanics import forces, plane

LENGTH, GRAVITY = 0.2, jnp.array([0.0, -9.81])
T, X = np.array([0.0, 1.0, 2.5, 4.0, 6.0]), np.array([0.0, 0.0, 3.0, 2.0, 2.0])  #: of the trolley [s], [m]


class Bushings(hb.System):
    """Bars of 1 kg in a row, each held by the one before with a spring and a damper in x and y."""

    n: int
    k: float
    c: float

    def mass_matrix(self, t, q):
        return jnp.diag(plane.mass_of_bodies(jnp.ones(self.n), LENGTH**2 / 12 * jnp.ones(self.n)))

    def gaps(self, q):
        half, none = LENGTH / 2 * jnp.ones(self.n), jnp.zeros(self.n)
        ends = {"a": jnp.stack([-half, none], 1), "b": jnp.stack([half.at[0].set(0.0), none], 1)}
        bodies = {"first": np.arange(self.n), "second": np.arange(-1, self.n - 1)}
        return plane.revolute_rows(plane.placed_with_ground(q), **bodies, **ends)

    def force(self, t, q, v):
        pulls = forces.force_of(self.gaps, forces.spring_damper(self.k, self.c, 0.0), q, v)
        return plane.weight_of_bodies(jnp.ones(self.n), GRAVITY) + pulls


def bushings(n, k, c, t_end):
    """They start in a horizontal line, at rest."""
    q0 = np.stack([LENGTH * (np.arange(n) + 0.5), np.zeros(n), np.zeros(n)], 1).ravel()
    return hb.Problem(name="bars", system=Bushings(n, k, c), t_span=(0, t_end), q0=q0, v0=0 * q0)


class Crane(hb.System):
    """A load of 5 kg on a rope of 2 m."""

    def mass_matrix(self, t, q):
        return jnp.diag(jnp.array([20.0, 5.0, 5.0]))

    def force(self, t, q, v):
        return jnp.stack([0.0, 0.0, -49.05])

    def constraint(self, t, q):
        return jnp.stack([q[0] - jnp.interp(t, T, X), ((q[1] - q[0]) ** 2 + q[2] ** 2 - 4) / 2])


crane = hb.Problem(name="crane", system=Crane(), t_span=(0, 6), q0=[0, 0, -2], v0=[0, 0, 0])


A, RATE = np.arctan2(1.63417211, 1.15303145), np.hypot(1.967857, 2.78901068) / 2  # of the rope at the end, to eight digits
crane_back = hb.Problem(
    name="crane_back",
    system=Crane(),
    t_span=(6, 1.5),
    q0=[2, 2 + 2 * np.sin(A), -2 * np.cos(A)],
    v0=[0, 2 * RATE * np.cos(A), 2 * RATE * np.sin(A)],
)


class Guide(hb.System):
    """A particle on a line whose direction jumps after a second: what happens there nobody says."""

    def force(self, t, q, v):
        return jnp.stack([1.0, 0.0])

    def constraint(self, t, q):
        return jnp.stack([jnp.where(t < 1.0, q[1], q[0] - 0.5 + q[1])])


guide = hb.Problem(name="guide", system=Guide(), t_span=(0, 2), q0=[0, 0], v0=[0, 0])
