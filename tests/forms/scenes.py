"""Consistent random states and all forms of one system behind two compiled functions."""

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.lowering import (
    AccelerationLevel,
    ConstraintLevels,
    compile_function,
    derive,
    reduce_redundant,
)
from hhtbench.protocol.system import NumpySystem, System, parameter
from solvers.forms import FORMS, make_form, refusal
from solvers.forms.layout import Layout, jacobian_function, residual_function
from solvers.forms.underlying import rhs_function, rhs_jacobian_function
from tests.lowering.systems import on_numpy, rich_constraint, rich_force, rich_mass, rich_velocity_constraint

C = 30.0  # weight of dF/dy' in the Jacobians [1/s]


class Linear(System):
    """Variable mass, rheonomic constraint, velocity constraint nonlinear in v, default reactions; n = 3, m = p = 1."""

    stiffness: Array = parameter(2.0, doc="stiffness [N/m]")

    def force(self, t, q, v):
        return rich_force(jnp, t, q, v, self.stiffness)

    def mass_matrix(self, t, q):
        return rich_mass(jnp, t, q)

    def constraint(self, t, q):
        return rich_constraint(jnp, t, q)

    def velocity_constraint(self, t, q, v):
        return rich_velocity_constraint(jnp, t, q, v)


LINEAR_NUMPY = NumpySystem(
    force=on_numpy(rich_force),
    mass_matrix=on_numpy(rich_mass),
    constraint=on_numpy(rich_constraint),
    velocity_constraint=on_numpy(rich_velocity_constraint),
)


class Moment:
    """A consistent random state of a system near a given one, with its acceleration level.

    Position and velocity are brought onto the constraints by Gauss-Newton steps; accelerations and multipliers come from
    :class:`AccelerationLevel`, which knows nothing of forms.
    """

    def __init__(self, dynamics, t, q, v, lam=None, mu=None, *, seed=1, s_q=1.0, s_v=1.0):
        random, levels = np.random.default_rng(seed), ConstraintLevels(dynamics)
        self.dynamics, self.t, self.random, self.levels = dynamics, t, random, levels
        q, v = q + 0.02 * s_q * random.normal(size=q.size), v + 0.1 * s_v * random.normal(size=q.size)
        for _ in range(8):
            at = levels.at(t, q, v)
            q = q - np.linalg.pinv(at.position_jacobian) @ at.position
        for _ in range(8):
            at = levels.at(t, q, v)
            rows = np.concatenate([at.position_jacobian, at.velocity_jacobian])
            v = v - np.linalg.pinv(rows) @ at.velocity_drift
        found = AccelerationLevel(dynamics).solve(t, q, v, lam, mu)
        self.q, self.v, self.vdot, self.lam, self.mu = q, v, found.vdot, found.lam, found.mu

    @property
    def packed(self):
        return self.q, self.v, self.vdot, self.lam, self.mu


def moment_of(problem, seed=1):
    """A consistent random state near a problem's start, at a time inside its interval."""
    place = problem.t_span[0], problem.q0, problem.v0
    dynamics = derive(problem.system, *place)
    if "redundant" in problem.tags:  # as solvers do
        at = ConstraintLevels(dynamics).at(*place)
        dynamics = reduce_redundant(dynamics, at.rank.redundant)
    t = problem.t_span[0] + 0.3 * (problem.t_span[1] - problem.t_span[0])
    guesses = problem.lam_guess, problem.mu_guess
    return Moment(dynamics, t, problem.q0, problem.v0, *guesses, seed=seed, s_q=problem.scales.q, s_v=problem.scales.v)


def all_residuals(dynamics, layouts, t, y, yp):
    """Residuals of all forms, one after the other; y' - rhs for the ode."""
    parts, start = [], 0
    for layout in layouts:
        place = slice(start, start := start + layout.size)
        ode = layout.name == "ode"
        parts.append(
            yp[place] - rhs_function(dynamics, t, y[place])
            if ode
            else residual_function(dynamics, layout, t, y[place], yp[place])
        )
    return dynamics.xp.concatenate(parts)


def all_jacobians(dynamics, layouts, t, y, yp, c):
    """Jacobians of all forms, each in row-major order."""
    parts, start = [], 0
    for layout in layouts:
        place = slice(start, start := start + layout.size)
        if layout.name == "ode":
            matrix = c * dynamics.xp.eye(layout.size) - rhs_jacobian_function(dynamics, t, y[place])
        else:
            matrix = jacobian_function(dynamics, layout, t, y[place], yp[place], c)
        parts.append(matrix.ravel())
    return dynamics.xp.concatenate(parts)


class Together:
    """All forms that a system has: compiled twice for all, not twice each."""

    def __init__(self, dynamics):
        s = dynamics.structure
        self.layouts = tuple(Layout(name, s) for name in FORMS if refusal(name, s) is None)
        self.names = [layout.name for layout in self.layouts]
        self.forms = {name: make_form(name, dynamics) for name in self.names}  # compiled on first call: never, here
        self._residual = compile_function(all_residuals, dynamics, self.layouts)
        self._jacobian = compile_function(all_jacobians, dynamics, self.layouts)

    def start(self, *packed):
        """(y, y') of all forms, concatenated."""
        starts = [form.start(*packed) for form in self.forms.values()]
        return np.concatenate([s.y for s in starts]), np.concatenate([s.yp for s in starts])

    def residual(self, t, y, yp):
        """Form -> residual."""
        return dict(zip(self.names, self._split(self._residual(t, y, yp)), strict=True))

    def jacobian(self, t, y, yp, c):
        """Form -> matrix."""
        packed = self._jacobian(t, y, yp, c)
        bounds = np.cumsum([layout.size**2 for layout in self.layouts])[:-1]
        parts = zip(self.layouts, np.split(packed, bounds), strict=True)
        return {layout.name: part.reshape(layout.size, layout.size) for layout, part in parts}

    def central_differences(self, t, y, yp, c):
        """Form -> dF/dy + c dF/dy' by fourth-order differences along the columns, all forms at once."""
        places = np.concatenate([np.arange(layout.size) for layout in self.layouts])
        columns = {name: [] for name in self.names}
        for j in range(places.max() + 1):
            steps = 1e-3 * np.maximum(1.0, np.abs(y)) * (places == j)
            size = {name: part.sum() for name, part in zip(self.names, self._split(steps), strict=True)}
            at = [self.residual(t, y + e * steps, yp + e * c * steps) for e in (-2, -1, 1, 2)]
            for name in self.names:
                if size[name]:
                    change = (at[0][name] - 8 * at[1][name] + 8 * at[2][name] - at[3][name]) / 12
                    columns[name].append(change / size[name])
        return {name: np.stack(found, axis=1) for name, found in columns.items()}

    def _split(self, values):
        return np.split(values, np.cumsum([layout.size for layout in self.layouts])[:-1])
