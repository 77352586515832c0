"""
A crane
=======

Forces, a mass and one constraint are the whole scene.  ``check`` looks at what was declared, ``solve`` integrates.
"""

import jax.numpy as jnp

import hhtbench as hb


class Crane(hb.System):
    """A trolley on a rail, pushed to and fro, with a load on a rope: q = (trolley x, load x, load y) [m]."""

    def mass_matrix(self, t, q):
        return jnp.diag(jnp.array([20.0, 5.0, 5.0]))

    def force(self, t, q, v):
        return jnp.stack([50.0 * jnp.sin(t) - 10.0 * v[0], 0.0, -9.81 * 5.0])

    def constraint(self, t, q):
        return jnp.stack([((q[1] - q[0]) ** 2 + q[2] ** 2 - 16.0) / 2])


crane = hb.Problem(name="crane", system=Crane(), t_span=(0, 10), q0=[0, 0, -4], v0=[0, 0, 0])
print(hb.check(crane).summary)
solution = hb.solve(crane, rtol=1e-4)
print(solution)

# %%
# The rope's length and its rate are kept to roundoff at every step: the last panel.
figure = solution.plot()
