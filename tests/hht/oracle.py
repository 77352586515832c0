"""The equations of a step written a second time, from THEORY.md in NumPy: what accepted steps leave of them.

Nothing of the solvers is used.  A System's own functions give M, F, g, k and the reactions, JAX their derivatives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from hhtbench.protocol.system import declared, reaction_takes_velocity

LEFT_BY_CONTROL = 0.02  # of what is allowed of a step: (H35) asks for 0.01 by an estimate, which the library exceeds by 1.6

TINY = np.finfo(float).tiny


class Terms(NamedTuple):
    """The terms of the equations of motion at N places, one row each."""

    M: np.ndarray  # (N, n, n)
    F: np.ndarray  # (N, n)
    Q: np.ndarray  # (N, n), the reaction of the position constraints
    Qk: np.ndarray  # (N, n), that of the velocity constraints
    g: np.ndarray  # (N, m)
    G: np.ndarray  # (N, m, n), g_q
    rate: np.ndarray  # (N, m), g_t + g_q v
    k: np.ndarray  # (N, p)
    K: np.ndarray  # (N, p, n), k_v

    def over_mass(self, x: np.ndarray) -> np.ndarray:
        """M^-1 x (N, n)."""
        return np.linalg.solve(self.M, x[..., None])[..., 0]

    @property
    def f(self) -> np.ndarray:
        """(H2)."""
        return self.over_mass(self.F)

    @property
    def r(self) -> np.ndarray:
        """(H2)."""
        return self.over_mass(self.Q)


Physics = Callable[..., Terms]


def physics_of(system: Any) -> Physics:
    """From (t, q, v, lam, mu), N rows each, to :class:`Terms`."""
    code = jax.jit(partial(_terms, system))

    def physics(*places: Any) -> Terms:
        rows = [code(*place) for place in zip(*places, strict=True)]
        return Terms(*map(np.array, zip(*rows, strict=True)))

    return physics


def _terms(system: Any, t: Any, q: Any, v: Any, lam: Any, mu: Any) -> Terms:
    """At one place; Q and Q_k as declared, or from the constraints, (H1)."""
    nothing = lambda *_: jnp.zeros(0)  # noqa: E731
    g, k = (declared(system, name) or nothing for name in ("constraint", "velocity_constraint"))
    level, rate = jax.jvp(g, (t, q), (jnp.ones_like(t), v))
    G = jax.jacfwd(g, 1)(t, q).reshape(-1, q.size)
    K = jax.jacfwd(k, 2)(t, q, v).reshape(-1, q.size)
    Q, Qk = -lam @ G, -mu @ K
    if hasattr(system, "reaction"):
        Q = system.reaction(t, q, v, lam) if reaction_takes_velocity(system) else system.reaction(t, q, lam)
    if hasattr(system, "velocity_reaction"):
        Qk = system.velocity_reaction(t, q, v, mu)
    mass = getattr(system, "mass_matrix", 1.0)
    mass = jnp.asarray(mass(t, q) if callable(mass) else mass)
    M = mass if mass.ndim == 2 else jnp.eye(q.size) * mass
    return Terms(M, system.force(t, q, v), Q, Qk, level, G, rate, k(t, q, v), K)


class Steps(NamedTuple):
    """The accepted steps of a run, one row each: the state before, the step, and what it ended with."""

    t0: np.ndarray  # (N,)
    q0: np.ndarray  # (N, n)
    v0: np.ndarray
    h: np.ndarray  # (N, 1)
    t1: np.ndarray
    q1: np.ndarray
    v1: np.ndarray
    a1: np.ndarray
    lam0: np.ndarray  # (N, m)
    lam1: np.ndarray
    mu: np.ndarray  # (N, p)


def steps_of(solution: Any, physics: Physics) -> Steps:
    """Those of a solution with a row at every step; multipliers of constraints that the solver leaves out are zero."""
    data, t, q, v = solution.steps_data, solution.t, solution.q, solution.v
    assert np.array_equal(data.t, t[1:]), "the solution has rows other than the ends of its steps"
    multipliers, kept = np.stack([data.lam_start, data.lam_end]), data.lam_end.shape[1]
    if kept < solution.lam.shape[1]:  # dependent rows: a pivoted QR of the unit rows at the start picks the others
        rows = physics(t[:1], q[:1], v[:1], 0 * solution.lam[:1], solution.mu[:1]).G[0]
        pivots = scipy.linalg.qr((rows / np.linalg.norm(rows, axis=1)[:, None]).T, pivoting=True)[2]
        whole = np.zeros((2, len(data.t), len(rows)))
        whole[:, :, np.sort(pivots[:kept])] = multipliers
        multipliers = whole
    return Steps(t[:-1], q[:-1], v[:-1], data.h[:, None], t[1:], q[1:], v[1:], data.a, *multipliers, data.mu_half)


class Left(NamedTuple):
    """What N steps leave of their equations, which ask for zero."""

    q: np.ndarray  # (N, n), of q1 by its own row, and by the accelerations that the balance of forces leaves
    v: np.ndarray  # (N, n), the same of v1
    on_q: np.ndarray  # (N,), of q1 by the constraints at the end of the step
    on_v: np.ndarray  # (N,), of v1 by both velocity levels

    def of_sizes(self, s: Steps, *, forces: bool = True) -> np.ndarray:
        """The most of q1 and v1 over the largest q and v up to the end of each step, (N,); of the constraints at least."""
        h = abs(s.h[:, 0])
        v = np.maximum(largest(s.v0), largest(s.v1))
        q = np.maximum(np.maximum(largest(s.q0), largest(s.q1)), h * v)
        q, v = (np.maximum.accumulate(np.maximum(x, TINY)) for x in (q, np.maximum(v, h * largest(s.a1))))
        found = np.maximum(self.on_q / q, self.on_v / v)
        return np.maximum(found, np.maximum(largest(self.q) / q, largest(self.v) / v)) if forces else found

    def of_tolerance(self, s: Steps, rtol: float, atol: Any) -> np.ndarray:
        """What is left of the forces over what is allowed of a step, in the norm of (H35), (N,)."""
        x0 = abs(np.concatenate([s.q0, s.v0], axis=1))
        n, allowed = s.q0.shape[1], rtol * x0 + atol
        tau = np.ones(len(x0))
        for part in (slice(n), slice(n, None)):
            size = np.maximum.accumulate(x0[:, part].max(axis=1, keepdims=True))
            tau = np.minimum(tau, (rtol + np.broadcast_to(atol, 2 * n)[part] / np.maximum(size, TINY)).min(axis=1))
        both = np.concatenate([self.q, self.v], axis=1) / allowed
        return np.sqrt((both**2).mean(axis=1) / tau)


def largest(x: np.ndarray) -> np.ndarray:
    """Of each row, (N,)."""
    return abs(x).max(axis=1, initial=0.0)


def left(s: Steps, end: Terms, weights: tuple[float, float], q: Any, v: Any, a: Any, *, levels: bool = True) -> Left:
    """Of the rows of q1, v1 and of accelerations; ``weights`` are beta and gamma, ``levels`` whether velocities are held."""
    beta, gamma = weights
    G, K = abs(end.G).sum(axis=2), abs(end.K).sum(axis=2)
    on_v = np.maximum(largest(end.rate / G), largest(end.k / K)) if levels else 0.0 * s.t0
    q = np.maximum(abs(q), beta * s.h**2 * abs(a))
    return Left(q, np.maximum(abs(v), gamma * abs(s.h * a)), largest(end.g / G), on_v)


def before(first: Any, x: np.ndarray) -> np.ndarray:
    """Every row's predecessor, ``first`` that of the first."""
    return np.concatenate([np.reshape(first, (1, -1)), x[:-1]])


def carried(s: Steps, f: Any, alpha: float, alpha_m: float = 0.0, *, start: Any = None, turned: Any = None) -> Any:
    """a0 and f1 (N, n) of every step, by (H11) and by (H6) or (H45), from ``f`` at the start.

    f1 is what these rows make of a1: what Newton's iteration leaves of the balance is its difference from M^-1 F.
    ``start`` is a0 of the first step, "trapezoidal" or None for f, (H12).  ``turned`` (N, n) is what (H56) adds.
    """
    alpha_f, a, last = alpha_m - alpha, f if start is None else start, s.h[0, 0]
    a0, f1 = np.empty_like(s.a1), np.empty_like(s.a1)
    if isinstance(start, str):
        a = (alpha * s.a1[0] + f) / (1 + alpha)
    for i, h in enumerate(s.h[:, 0]):
        if h != last:  # (H11), and from f again after a step a hundred times as long
            a = f if abs(h) < 0.01 * abs(last) else f + h / last * (a - f)
        a0[i] = a if turned is None else a + turned[i]
        f = f1[i] = ((1 - alpha_m) * s.a1[i] + alpha_m * a0[i] - alpha_f * f) / (1 - alpha_f)
        a, last = s.a1[i], h
    return a0, f1


@dataclass(frozen=True, kw_only=True)
class Extended:
    """The extended HHT, (H3) to (H12), and with ``alpha_m`` the extended generalised-alpha, (H45)."""

    alpha: float = -0.05
    b: float = 0.0
    reaction: str = "implicit"
    alpha_m: float = 0.0

    def left(self, physics: Physics, s: Steps, *, start: Any = None, lam: Any = None) -> Left:
        """``start`` as of :func:`carried`; ``lam`` (m,) of (H16) at the start where multipliers are extrapolated, (H55)."""
        beta, gamma = weights = (1 - self.alpha) ** 2 / 4, 0.5 - self.alpha  # (H3)
        h, midpoint, turned = s.h, self.reaction.startswith("midpoint"), None
        lam_x0 = lam_x1 = 0 * s.lam1
        if lam is not None:
            lam_x1 = before(lam, s.lam1)  # (H55)
            lam_x0 = before(lam, lam_x1)
            change = lam_x1 - lam_x0
            rate = change - h / before(h[0], h) * before(0 * lam, change)
            turned = self.alpha * physics(s.t0, s.q0, s.v0, rate, s.mu).r  # (H56)
        start_r, end = physics(s.t0, s.q0, s.v0, s.lam0 - lam_x0, s.mu), physics(s.t1, s.q1, s.v1, lam_x1, s.mu)
        f, f1 = start_r.f[0], end.f
        if lam is not None:
            f, f1 = f + physics(s.t0, s.q0, s.v0, lam_x0, s.mu).r[0], f1 + end.r
        a0, carried_f1 = carried(s, f, self.alpha, self.alpha_m, start=start, turned=turned)
        R0, R1, Rk = start_r.r, self._end_reaction(physics, s, lam_x0, lam_x1), self._velocity_reaction(physics, s)
        of_q = (1 - 2 * beta) * a0 + 2 * beta * s.a1 + (1 - self.b) * R0 + self.b * R1 + Rk
        of_v = (1 - gamma) * a0 + gamma * s.a1 + (R1 if midpoint else (R0 + R1) / 2) + Rk
        q = s.q1 - (s.q0 + h * s.v0 + h**2 / 2 * of_q)  # (H4)
        return left(s, end, weights, q, s.v1 - (s.v0 + h * of_v), carried_f1 - f1)  # (H5), (H6)

    def _end_reaction(self, physics: Physics, s: Steps, lam_x0: Any, lam_x1: Any) -> np.ndarray:
        """(H8), with the velocity of (H50)."""
        midpoint, t, v = self.reaction.startswith("midpoint"), s.t1, s.v1
        q = s.q0 + s.h * s.v0 if self.reaction.endswith("predictor") else s.q1  # (H9)
        if midpoint:
            t, q, v, lam_x1 = (s.t0 + s.t1) / 2, (s.q0 + q) / 2, (s.v0 + s.v1) / 2, (lam_x0 + lam_x1) / 2
        return physics(t, q, v, s.lam1 - lam_x1, s.mu).r

    def _velocity_reaction(self, physics: Physics, s: Steps) -> np.ndarray:
        """(H10)."""
        if s.mu.shape[1] == 0:
            return 0 * s.v0
        half = physics(s.t0 + s.h[:, 0] / 2, s.q0 + s.h * s.v0 / 2, (s.v0 + s.v1) / 2, s.lam0, s.mu)
        return half.over_mass(half.Qk)


@dataclass(frozen=True, kw_only=True)
class GeneralisedAlpha:
    """(H36) to (H41), for reactions -g_q^T lam."""

    rho: float
    stabilised: bool

    @property
    def alphas(self) -> tuple[float, float]:
        """alpha_m and alpha_f, (H39)."""
        return (2 * self.rho - 1) / (self.rho + 1), self.rho / (self.rho + 1)

    def left(self, physics: Physics, s: Steps, *, start: Any, vdot: Any) -> Left:
        """``start`` (n,) is a0 of the first step and ``vdot`` (n,) the acceleration there."""
        alpha_m, alpha_f = self.alphas
        alpha = alpha_m - alpha_f
        beta, gamma = weights = (1 - alpha) ** 2 / 4, 0.5 - alpha
        a0, vdot1 = carried(s, vdot, alpha, alpha_m, start=start)  # (H39), (H41)
        end, h = physics(s.t1, s.q1, s.v1, s.lam1, s.mu), s.h
        q = s.q1 - (s.q0 + h * s.v0 + h**2 * ((0.5 - beta) * a0 + beta * s.a1))  # (H36)
        if self.stabilised:  # (H40): no solution tells eta, so the row holds up to M0^-1 g_q^T eta
            begin = physics(s.t0, s.q0, s.v0, s.lam0, s.mu)
            for i, (M, G) in enumerate(zip(begin.M, begin.G, strict=True)):
                columns = np.linalg.solve(M, G.T)
                q[i] -= columns @ np.linalg.lstsq(columns, q[i], rcond=None)[0]
        v = s.v1 - (s.v0 + h * ((1 - gamma) * a0 + gamma * s.a1))
        return left(s, end, weights, q, v, vdot1 - end.f - end.r, levels=self.stabilised)  # (H37)


@dataclass(frozen=True, kw_only=True)
class HHTI3:
    """(H36) with (H42)."""

    alpha: float = -0.05

    def left(self, physics: Physics, s: Steps, *, vdot: Any, lam: Any) -> Left:
        """``vdot`` (n,) and ``lam`` (m,) are those of (H16) at the start."""
        beta, gamma = weights = (1 - self.alpha) ** 2 / 4, 0.5 - self.alpha
        begin = physics(s.t0, s.q0, s.v0, before(lam, s.lam1), s.mu)
        end = physics(s.t1, s.q1, s.v1, s.lam1, s.mu)
        a0, h = before(vdot, s.a1), s.h
        q = s.q1 - (s.q0 + h * s.v0 + h**2 * ((0.5 - beta) * a0 + beta * s.a1))
        v = s.v1 - (s.v0 + h * ((1 - gamma) * a0 + gamma * s.a1))
        balance = s.a1 - end.over_mass((1 + self.alpha) * (end.F + end.Q) - self.alpha * (begin.F + begin.Q))
        return left(s, end, weights, q, v, balance, levels=False)


@dataclass(frozen=True, kw_only=True)
class Rattle:
    """(H43)."""

    def left(self, physics: Physics, s: Steps) -> Left:
        """It has no auxiliary accelerations: a1 is v' at the end."""
        begin, end = physics(s.t0, s.q0, s.v0, s.lam0, s.mu), physics(s.t1, s.q1, s.v1, s.lam1, s.mu)
        half = s.v0 + s.h / 2 * (begin.f + begin.r)
        q, v = s.q1 - (s.q0 + s.h * half), s.v1 - (half + s.h / 2 * s.a1)
        return left(s, end, (0.0, 0.5), q, v, s.a1 - end.f - end.r)
