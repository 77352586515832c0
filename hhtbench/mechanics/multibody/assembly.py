"""Consistent starts of mechanisms from rough poses, degrees of freedom and redundant joints.

Positions: Gauss-Newton steps of least norm in the masses, ``dq = -W (G W)^+ g`` with ``M^-1 = W W^T``; velocities: one such
step.  Source: A. A. Shabana, Computational Dynamics, Wiley 2010, chapter 3; least squares by singular values.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from scipy.sparse.csgraph import connected_components

from hhtbench.mechanics.multibody.readings import angles_now, travels_now
from hhtbench.protocol.errors import ProblemError

ITERATIONS = 50
CLOSED = 1e-12  # largest residual of joints that hold [m, rad], over the size of the mechanism
OPEN = 1e-8  # residual of a joint that is named as open
RANK = 1e-9  # singular values below this part of the largest are zero
PART = 0.5  # radians by which prescribed angles approach their values at a time
HALVINGS = 8  # of a step that does not bring the joints closer


@dataclass(frozen=True)
class Mobility:
    """Degrees of freedom of a mechanism in one pose."""

    degrees_of_freedom: int
    redundant: int  #: number of rows that follow from others
    sharing: tuple[tuple[str, ...], ...]  #: joints whose reactions are not unique, in sets that share their loads

    def __str__(self) -> str:
        text = f"{self.degrees_of_freedom} degrees of freedom"
        if not self.redundant:
            return f"{text}, no redundant rows"
        sets = "; ".join(", ".join(names) for names in self.sharing)
        return f"{text}, {self.redundant} redundant rows: these joints share their loads: {sets}"


def mobility(m: Any) -> Mobility:
    """Degrees of freedom and redundant joints of the mechanism ``m`` at its present pose."""
    system, (q, v) = m.system(), m.start()
    own = 0 if m.plane else len(m.bodies)
    G = np.concatenate([part for part in _jacobians(system, 0.0, q, v) if part is not None] or [np.zeros((0, q.size))])
    if not len(G):
        return Mobility(q.size, 0, ())
    left, sizes, _ = np.linalg.svd(G)
    rank = int(np.sum(sizes > RANK * sizes[0]))
    redundant = len(G) - rank
    if not redundant:
        return Mobility(q.size - rank, 0, ())
    cancelling = left[:, rank:] @ left[:, rank:].T  # projector on reactions that cancel
    names = list(m.joints)
    of_row = np.full(len(G), -1)
    for i, rows in enumerate(m.rows_by_joint().values()):
        of_row[rows] = i
    share = np.zeros((len(names), len(names)))
    for i, j in np.argwhere(abs(cancelling) > math.sqrt(RANK)):
        if i >= own and j >= own and of_row[i] >= 0 and of_row[j] >= 0:
            share[of_row[i], of_row[j]] = 1
    count, label = connected_components(share, directed=False)
    sets = [tuple(name for name, at in zip(names, label, strict=True) if at == i) for i in range(count)]
    loaded = {name for name, row in zip(names, share, strict=True) if row.any()}
    return Mobility(q.size - rank, redundant, tuple(one for one in sets if loaded & set(one)))


def assemble(m: Any, at: dict[str, float], rates: dict[str, float], t: float) -> Mobility:
    """Move the bodies of the mechanism ``m`` to a consistent start, see ``Mechanism.assemble``."""
    trial = _copied(m)
    now = {name: _now(m, name) for name in at}
    count = max([1, *(math.ceil(abs(at[name] - now[name]) / PART) for name in at)])
    q, v = m.start()
    weight = _weight(trial.system(), t, q)
    for part in range(1, count + 1):
        towards = {name: now[name] + (value - now[name]) * part / count for name, value in at.items()}
        held = _copied(m)
        for name, value in towards.items():
            held.motor(f"assembled {name}", name, _constant(value))
        q = _closed(held, t, q, weight)
    _place(m, q, v)
    _expect_signs(m)
    driven = _copied(m)
    for name in rates:
        driven.motor(f"assembled {name}", name, _moving(at.get(name, _now(m, name)), rates[name], t))
    v = _moved(driven, t, q, v, weight)
    _place(m, q, v)
    return mobility(m)


def _copied(m: Any) -> Any:
    """A copy of ``m`` to which rows can be added."""
    trial = copy.copy(m)
    trial.joints, trial.rows = dict(m.joints), {name: list(rows) for name, rows in m.rows.items()}
    trial.bodies = {name: copy.copy(body) for name, body in m.bodies.items()}
    return trial


def _now(m: Any, name: str) -> float:
    """Angle or travel of a joint at the present pose."""
    joint = m._find(name, "revolute", "prismatic", "cylindrical")
    at = m.frame.placed(jnp.asarray(m.start()[0]))
    return float((travels_now if joint.kind == "prismatic" else angles_now)(m, joint, at))


def _constant(value: float) -> Any:
    return lambda t: value


def _moving(value: float, rate: float, t0: float) -> Any:
    return lambda t: value + rate * (t - t0)


def _weight(system: Any, t: float, q: Any) -> Any:
    mass = system.mass_matrix
    M = np.asarray(mass(t, jnp.asarray(q)) if callable(mass) else mass)
    if M.ndim == 1:
        return np.diag(M**-0.5)
    return scipy.linalg.solve_triangular(np.linalg.cholesky(M), np.eye(len(M)), lower=True).T


def _jacobians(system: Any, t: float, q: Any, v: Any) -> tuple[Any, Any]:
    """Jacobians of the position rows by q and of the velocity rows by v; None without rows."""
    found = _compiled_jacobians(system, jnp.asarray(t, float), jnp.asarray(q), jnp.asarray(v))
    return tuple(None if one is None else np.asarray(one) for one in found)  # type: ignore[return-value]


@eqx.filter_jit  # compiles once for all mechanisms of one structure
def _compiled_jacobians(system: Any, t: Any, q: Any, v: Any) -> tuple[Any, Any]:
    G = None if system.constraint is None else jax.jacfwd(system.constraint, 1)(t, q)
    return G, None if system.velocity_constraint is None else jax.jacfwd(system.velocity_constraint, 2)(t, q, v)


@eqx.filter_jit
def _residual(system: Any, t: Any, q: Any) -> Any:
    return system.constraint(t, q)


def _closed(m: Any, t: float, q: Any, weight: Any) -> Any:
    """Coordinates near ``q`` at which all joints hold."""
    system = m.system()
    if system.constraint is None:
        return q
    residual = lambda q: np.asarray(_residual(system, jnp.asarray(t, float), jnp.asarray(q)))  # noqa: E731
    size = max(1.0, float(np.max(np.abs(q))))
    g = residual(q)
    for _ in range(ITERATIONS):
        if np.max(np.abs(g), initial=0.0) <= CLOSED * size:
            return q
        step = -weight @ np.linalg.lstsq(_jacobians(system, t, q, q)[0] @ weight, g, rcond=RANK)[0]
        for i in range(HALVINGS):
            there = residual(q + step / 2**i)
            if np.linalg.norm(there) < np.linalg.norm(g):
                break
        q, g = q + step / 2**i, there
    if np.max(np.abs(g)) <= math.sqrt(CLOSED) * CLOSED**0.25 * size:
        return q
    raise ProblemError(f"the joints cannot be brought together: {_open(m, g)} stay open. Give a better pose.")


def _open(m: Any, g: Any) -> str:
    return ", ".join(
        f"{name!r} ({np.max(np.abs(g[rows])):.1e})"
        for name, rows in m.rows_by_joint().items()
        if rows.size and np.max(np.abs(g[rows])) > OPEN
    )


def _moved(m: Any, t: float, q: Any, v: Any, weight: Any) -> Any:
    """Velocities near ``v`` that all joints allow."""
    system = m.system()
    q, v = jnp.asarray(q), jnp.asarray(v)
    parts, rests = [], []
    G, K = _jacobians(system, t, q, v)
    if G is not None:
        moving = jax.jvp(lambda s: system.constraint(s, q), (float(t),), (1.0,))[1]
        parts.append(G)
        rests.append(np.asarray(G @ v + moving))
    if K is not None:
        parts.append(K)
        rests.append(np.asarray(system.velocity_constraint(t, q, v)))
    if not parts:
        return np.asarray(v)
    C, rest = np.concatenate(parts), np.concatenate(rests)
    found = np.asarray(v) - weight @ np.linalg.lstsq(C @ weight, rest, rcond=RANK)[0]
    left = C @ found - (C @ np.asarray(v) - rest)
    if np.max(np.abs(left)) > OPEN * max(1.0, float(np.max(np.abs(found)))):
        names = _open(m, left)
        raise ProblemError(f"no velocities agree with all rates and joints: {names or 'rolling or a prescribed rate'}.")
    return found


def _place(m: Any, q: Any, v: Any) -> None:
    """Store coordinates and velocities as poses of the bodies."""
    at, rates = m.frame.placed(jnp.asarray(q)), np.asarray(m.frame.rates(jnp.asarray(q), jnp.asarray(v)))
    parts, moving = np.reshape(q, (-1, m.frame.size)), np.reshape(v, (-1, m.frame.size))
    for i, body in enumerate(m.bodies.values()):
        body.x, body.velocity, body.rate = parts[i, : m.dimension], moving[i, : m.dimension], rates[i]
        body.R, body.angle = np.asarray(at.R[i]), float(parts[i, 2]) if m.plane else 0.0


def _expect_signs(m: Any) -> None:
    """Raise if an axis that a joint holds parallel ended reversed: its rows hold at half a turn too."""
    if m.plane:
        return
    for joint in m.joints.values():
        e = [m.pose(body)[1] @ frame for body, frame in zip((joint.first, joint.second), joint.frames, strict=True)]
        axes = [2] if joint.kind in ("revolute", "cylindrical", "prismatic", "planar") else []
        axes += [0, 1, 2] if joint.kind in ("weld", "prismatic") else []
        if any(e[0][:, i] @ e[1][:, i] < 0.0 for i in axes):
            raise ProblemError(f"joint {joint.name!r} came together with its axis reversed. Give a better pose.")
