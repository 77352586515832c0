"""``modes``: frequencies, damping and shapes of small motions about an equilibrium or a steady motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.linear.states import FixedTime, Rates
from hhtbench.linear.statics import Equilibrium, equilibrium
from hhtbench.linear.tangent import Linear
from hhtbench.protocol.arguments import Matrix, Vector, real_vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem

STEADY = 1e-6  # relative change of the linearised equations along a steady motion, by roundoff and differences


@dataclass(frozen=True, kw_only=True)
class Modes:
    """Small motions ``shapes[:, i] exp(eigenvalues[i] t)`` about one state, slowest first; one of each conjugate pair.

    Free motions, as of a body that nothing holds, have eigenvalues of zero.
    """

    eigenvalues: Any  #: (k,) complex [1/s]
    frequencies: Vector  #: (k,) |eigenvalue| / (2 pi), those without damping [Hz]
    damping: Vector  #: (k,) -real part / |eigenvalue|: 0 undamped, 1 without oscillation, below 0 growing
    shapes: Any  #: (n, k) complex, changes of q; the largest entry is 1
    q: Vector  #: (n,) position of the state [m, rad]
    v: Vector  #: (n,) velocities there; zero at rest

    @property
    def stable(self) -> bool:
        """True if no small motion grows."""
        return not np.any(self.eigenvalues.real > 0.0)


def modes(
    problem: Problem,
    at: Equilibrium | tuple[Any, Any] | None = None,
    *,
    t: float | None = None,
    along: Callable[[Vector], Any] | None = None,
) -> Modes:
    """Linearise the motion about a state and return its modes.

    Parameters
    ----------
    problem
        Its constraints must not move parts by time; forces that depend on time are taken at ``t``.
    at
        An :class:`Equilibrium`, or (q, v), (n,) each: a state at rest or in steady motion.  By default the equilibrium near
        ``problem.q0``.
    t
        Time [s]; the start of the problem by default.
    along
        Function of q (n,) that returns the velocities (n,) of the steady motion through q, affine in q: the equations do
        not change along it.  By default v everywhere, for coordinates that grow evenly; for turning bodies see
        :func:`hhtbench.mechanics.space.carried`.

    Raises
    ------
    ProblemError
        The state violates a constraint, or is neither an equilibrium nor a steady motion.
    """
    if at is None:
        at = equilibrium(problem, t)
    if isinstance(at, Equilibrium):
        zero = np.zeros(at.q.size)
        now = FixedTime(problem, at.t)
        linear = now.linear(now.terms(at.q, zero, Rates(zero, at.lam, at.mu)), np.zeros((zero.size, zero.size)))
        return _modes_of(linear, now.error, at.q, zero)
    if not isinstance(at, (tuple, list)) or len(at) != 2:
        raise TypeError(f"at must be an Equilibrium or a pair (q, v); got {type(at).__name__}.")
    now = FixedTime(problem, t)
    q, v = now.positions("at[0]", at[0]), now.positions("at[1]", at[1])
    return _modes_of(_linear_at(now, q, v, _matrix_of(along, q, v)), now.error, q, v)


def _matrix_of(along: Callable[[Vector], Any] | None, q: Vector, v: Vector) -> Matrix:
    """X (n, n) of the affine function ``along``, whose value at q must be v."""
    n = q.size
    if along is None:
        return np.zeros((n, n))
    here = real_vector("along(q)", along(q), n)
    if not np.allclose(here, v, rtol=1e-9, atol=1e-9 * np.abs(v).max()):
        raise ProblemError(f"along(q) must be the velocity of the state, {v}; got {here}.")
    return np.stack([real_vector("along(q)", along(q + unit), n) - here for unit in np.eye(n)], axis=1)


def _linear_at(now: FixedTime, q: Vector, v: Vector, X: Matrix) -> Linear:
    """The linearised equations at (q, v), after a check that the motion there is steady."""
    now.expect_time_free(q)
    now.expect_consistent(q, v)
    terms = now.terms(q, v, now.multipliers(q, v, X @ v))
    now.expect_steady(terms, q)
    linear = now.linear(terms, X)
    if np.any(v) and (change := linear.leaves(v, X @ v)) > STEADY:
        raise ProblemError(
            f"{now.problem.name}: the motion is not steady: the linearised equations change along it by {change:.1e}. "
            "Give along=, the velocities as a function of q, for bodies that turn."
        )
    return linear


def _modes_of(linear: Linear, error: float, q: Vector, v: Vector) -> Modes:
    """Eigenvalues and shapes, slowest first."""
    found = linear.spectrum(error)
    order = [i for i in np.argsort(np.abs(found.values), kind="stable") if found.values[i].imag >= 0.0]
    values, shapes = found.values[order], linear.positions @ found.vectors[:, order]
    largest = shapes[np.argmax(np.abs(shapes), axis=0), np.arange(len(order))]
    size = np.abs(values)
    return Modes(
        eigenvalues=values,
        frequencies=size / (2 * np.pi),
        damping=(0.0 - values.real) / np.where(size > 0.0, size, 1.0),
        shapes=shapes / np.where(largest == 0.0, 1.0, largest),
        q=q,
        v=v,
    )
