"""Systems whose owner changes them, for what is prepared of a system once."""

import dataclasses

import jax.numpy as jnp
import numpy as np

import hhtbench as hb


class Sprung(hb.System):
    """A pendulum on springs; they and its mass are arrays that their owner may write to."""

    length: object = hb.parameter(1.0)
    springs: object = dataclasses.field(default_factory=lambda: np.array([3.0, 5.0]))
    mass_matrix: object = dataclasses.field(default_factory=lambda: np.array([1.0, 2.0]))

    def force(self, t, q, v):
        return jnp.array([0.0, -9.81]) - self.springs * q

    def constraint(self, t, q):
        return jnp.stack([(q @ q - self.length**2) / 2])


class Declared(Sprung):
    """The same with declared derivatives; that of the constraint is ``slanted``, wrong where this is not zero."""

    slanted: object = dataclasses.field(default_factory=lambda: np.zeros(1))

    def constraint_jacobian(self, t, q):
        return (q + self.slanted)[None, :]

    def force_jacobians(self, t, q, v):
        return -jnp.diag(self.springs), None


class Redundant(Sprung):
    """The same with its constraint twice."""

    def constraint(self, t, q):
        return jnp.stack([(q @ q - self.length**2) / 2] * 2)


class Massless(Sprung):
    """The same without mass along the rod at its start to the right: the constraint determines that acceleration."""

    mass_matrix: object = dataclasses.field(default_factory=lambda: np.array([0.0, 2.0]))
