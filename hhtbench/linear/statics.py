"""``equilibrium``: a position at rest, its multipliers, and whether it is stable.

Newton's iteration on ``F + Q + Q_k = 0``, ``g = 0`` at v = 0, with a diagonal N (that of M) in its matrix,

    [c N + R_q, -Q_lam, -Q_mu; g_q, 0, 0; k_v, 0, 0] [dq; dlam; dmu] = -[R; g; 0].

c is the least for which the stiffness on the tangent space is positive and the step no longer than allowed, as in the trust
region methods of optimisation (J. Nocedal, S. J. Wright, Numerical Optimization, 2006, chapter 4): downhill to a position
that is stable.  Where that fails, c = 0, Newton's method.  Redundant rows and free coordinates take the step of least norm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import eigh

from hhtbench.linear.states import FixedTime, Rates
from hhtbench.linear.tangent import Terms, decomposed
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem

MAX_ITERATIONS = 300  # a chain of 40 links that falls from the level takes 60; the rest is for contacts
MAX_STEP = 0.3  # of a coordinate's size: curved constraints are met again from there
PATIENCE = 30  # iterations after which steps are half as long, and a third after twice as many: no cycle persists
MAX_DOUBLINGS = 100  # of the added stiffness: from roundoff beyond any other
BALANCED = 1e-12  # imbalance of forces relative to the largest ones met
ROUNDOFF = 1e-13  # error of a force relative to stiffness times size, and of a constraint relative to its row
SINGULAR = 1e-13  # singular values of the scaled matrix, relative to the largest, that are zero


@dataclass(frozen=True, kw_only=True)
class Equilibrium:
    """A position at rest in which all forces balance."""

    t: float  #: time at which forces are taken [s]
    q: Vector  #: (n,) position [m, rad]
    lam: Vector  #: (m,) multipliers of the position constraints [N, N m], of least norm where rows are redundant
    mu: Vector  #: (p,) multipliers of the velocity constraints [N, N m]
    residual: float  #: largest force that remains at a coordinate [N, N m]
    iterations: int  #: of Newton's method
    stable: bool  #: no small motion about it grows


def equilibrium(problem: Problem, t: float | None = None, q: Any = None) -> Equilibrium:
    """Find a position at rest, a stable one where a way downhill leads to it.

    Parameters
    ----------
    problem
        Its constraints must not move parts by time; forces that depend on time are taken at ``t``.
    t
        Time [s]; the start of the problem by default.
    q
        (n,) where to begin [m, rad]; ``problem.q0`` by default.  An equilibrium there is returned as it is, stable or not.

    Raises
    ------
    ProblemError
        No equilibrium was found, or the problem has none, as a constraint moves with time.

    Example
    -------
    >>> rest = hb.equilibrium(problem)
    >>> rest.q, rest.lam, rest.stable
    """
    at = FixedTime(problem, t)
    q = at.positions("q", problem.q0 if q is None else q)
    at.expect_time_free(q)
    found, iterations, misfit = descend(at, q, downhill=True)
    if found is None:
        found, more, misfit = descend(at, q, downhill=False)
        iterations += more
    if found is None:
        raise ProblemError(
            f"{problem.name}: no equilibrium found from this position in {iterations} iterations; {misfit} remains. "
            "Give another q to begin with; bodies that nothing holds have none."
        )
    zero = np.zeros(q.size)
    terms = at.terms(found.q, zero, Rates(zero, found.lam, found.mu))
    return Equilibrium(
        t=at.t,
        q=found.q,
        lam=found.lam,
        mu=found.mu,
        residual=float(np.abs(terms.balance).max()),
        iterations=iterations,
        stable=not at.linear(terms, np.zeros((zero.size, zero.size))).spectrum(at.error).grows,
    )


class Rest(NamedTuple):
    """A position (n,) at rest with multipliers (m,) and (p,)."""

    q: Vector
    lam: Vector
    mu: Vector


def descend(at: FixedTime, q: Vector, *, downhill: bool) -> tuple[Rest | None, int, str]:
    """Equilibrium from ``q`` (n,), None if there is none; the iterations, and what remained.

    ``downhill``: avoid positions that are not stable.
    """
    zero, s, sizes = np.zeros(q.size), at.structure, at.sizes(q)
    x = np.concatenate([q, *_guess(at, q)])
    largest, misfit, rank = 0.0, "", at.rank(q)
    for iteration in range(MAX_ITERATIONS):
        q, lam, mu = np.split(x, [s.n, s.n + s.m])
        terms = at.terms(q, zero, Rates(zero, lam, mu), rank)
        free = np.abs(terms.virtual @ (terms.virtual.T @ terms.balance))
        stiffness = np.abs(terms.by_q) @ np.broadcast_to(sizes, q.shape)
        largest = max(largest, free.max(), np.abs(terms.columns @ x[s.n :]).max())
        open_rows = np.abs(terms.position) / np.maximum(np.abs(terms.of_position) @ np.broadcast_to(sizes, q.shape), 1e-300)
        misfit = f"a force of {free.max():.3g} and a constraint of {np.abs(terms.position).max(initial=0.0):.3g}"
        if free.max() <= BALANCED * largest + ROUNDOFF * stiffness.max() and open_rows.max(initial=0.0) <= ROUNDOFF * 1e2:
            found = at.multipliers(q, zero, zero) if s.linear_reaction else Rates(zero, lam, mu)  # of least norm
            return Rest(q, found.lam, found.mu), iteration, misfit
        longest = MAX_STEP * np.broadcast_to(sizes, q.shape) / (1.0 + iteration / PATIENCE)
        step = _newton_step(terms, _added_stiffness(terms, longest) if downhill else np.zeros(s.n))
        length = float((np.abs(step[: s.n]) / longest).max())
        if not np.isfinite(length):
            return None, iteration, misfit
        x = x + step / max(1.0, length)
    return None, MAX_ITERATIONS, misfit


def _guess(at: FixedTime, q: Vector) -> tuple[Vector, Vector]:
    """Multipliers to begin with: those that balance the forces best; of a nonlinear reaction as declared, or zero."""
    s, given = at.structure, (at.problem.lam_guess, at.problem.mu_guess)
    if s.linear_reaction:
        return at.multipliers(q, np.zeros(s.n), np.zeros(s.n))[1:]
    lam, mu = (np.zeros(k) if x is None else x for k, x in zip((s.m, s.p), given, strict=True))
    return lam, mu


def _added_stiffness(terms: Terms, longest: Vector) -> Vector:
    """Least c N (n,) that makes the stiffness on the tangent space positive and the step no longer than ``longest`` (n,)."""
    diagonal, Z = np.abs(terms.mass.diagonal()), terms.free
    metric = np.where(diagonal > 0.0, diagonal, diagonal.mean() or 1.0)
    if not Z.shape[1]:
        return 0.0 * metric
    stiffness = Z.T @ (terms.by_q + terms.by_q.T) @ Z / 2
    values, vectors = eigh(stiffness, Z.T @ (metric[:, None] * Z))
    ways = Z @ vectors
    forces = ways.T @ terms.balance
    c, noise = (
        max(0.0, -2.0 * float(values[0])),
        SINGULAR * float(np.abs(values).max() + np.abs(forces).max() / longest.min()),
    )
    for _ in range(MAX_DOUBLINGS):
        step = ways @ (forces / np.maximum(values + c, noise or 1.0))
        if np.all(np.abs(step) <= longest):
            break
        c = max(2.0 * c, noise)
    return c * metric


def _newton_step(terms: Terms, added: Vector) -> Vector:
    """Step (n + m + p,) of [q; lam; mu] of least norm; ``added`` (n,) is the diagonal c N."""
    n, shares = terms.mass.shape[0], decomposed(terms.rows, terms.rank).shares
    right = np.concatenate([terms.position, np.zeros(len(shares) - terms.position.size)])
    corner = np.zeros((shares.shape[1], shares.shape[1]))
    matrix: Matrix = np.block([[terms.by_q + np.diag(added), -terms.columns @ shares], [shares.T @ terms.rows, corner]])
    right = -np.concatenate([terms.balance, shares.T @ right])
    of_row = _or_one(np.abs(matrix).max(axis=1))
    matrix = matrix / of_row[:, None]
    of_column = _or_one(np.abs(matrix).max(axis=0))
    step = np.linalg.lstsq(matrix / of_column, right / of_row, rcond=SINGULAR)[0] / of_column
    return np.concatenate([step[:n], shares @ step[n:]])


def _or_one(sizes: Vector) -> Vector:
    return np.where(sizes > 0.0, sizes, 1.0)
