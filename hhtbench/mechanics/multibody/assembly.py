"""Consistent starts of mechanisms from rough poses, degrees of freedom and redundant joints.

Positions: Gauss-Newton steps of least norm in the masses, ``dq = -W (G W)^+ g`` with ``M^-1 = W W^T``; velocities: one such
step.  Source: A. A. Shabana, Computational Dynamics, Wiley 2010, chapter 3; least squares by singular values.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from scipy.sparse.csgraph import connected_components

from hhtbench.mechanics.multibody.readings import along, moves
from hhtbench.protocol.errors import ProblemError

ITERATIONS = 50
CLOSED = 1e-12  # largest residual of joints that hold [m, rad], over the size of the mechanism
CLOSED_ENOUGH = 1e-9  # where further iterations do not come closer
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


class _Local(NamedTuple):
    """Rows, their Jacobians and the masses at one time and state; None without rows."""

    mass: Any
    g: Any
    G: Any  #: of the position rows by q
    moving: Any  #: derivative of the position rows by time
    k: Any
    K: Any  #: of the velocity rows by v


def _local(system: Any, t: float, q: Any, v: Any) -> Any:
    found = _compiled(system, *(jnp.asarray(x, float) for x in (t, q, v)))
    return _Local(*(None if one is None else np.asarray(one) for one in found))


@eqx.filter_jit  # compiles once for all mechanisms of one structure
def _compiled(system: Any, t: Any, q: Any, v: Any) -> _Local:
    mass = system.mass_matrix(t, q) if callable(system.mass_matrix) else jnp.asarray(system.mass_matrix)
    rows: tuple[Any, ...] = (None, None, None)
    velocity_rows: tuple[Any, ...] = (None, None)
    if system.constraint is not None:
        G, moving = jax.jacfwd(system.constraint, (1, 0))(t, q)
        rows = system.constraint(t, q), G, moving
    if system.velocity_constraint is not None:
        velocity_rows = system.velocity_constraint(t, q, v), jax.jacfwd(system.velocity_constraint, 2)(t, q, v)
    return _Local(mass, *rows, *velocity_rows)


def mobility(m: Any) -> Mobility:
    """Degrees of freedom and redundant joints of the mechanism ``m`` at its present pose."""
    system, (q, v) = m.system(), m.start()
    own, here = 0 if m.plane else len(m.bodies), _local(system, 0.0, q, v)
    G = np.concatenate([part for part in (here.G, here.K) if part is not None] or [np.zeros((0, q.size))])
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
    for rows, start in ((m.rows_by_joint(), 0), (m.velocity_rows_by_joint(), 0 if here.G is None else len(here.G))):
        for i, numbers in enumerate(rows.values()):
            of_row[start + numbers] = i
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
    before = {name: copy.copy(body) for name, body in m.bodies.items()}
    try:
        _assemble(m, at, rates, t)
    except ProblemError:
        m.bodies.update(before)
        raise
    return mobility(m)


def _assemble(m: Any, at: dict[str, float], rates: dict[str, float], t: float) -> None:
    now = {name: _now(m, name) for name in at}
    count = max([1, *(math.ceil(abs(at[name] - now[name]) / PART) for name in at)])
    q, v = m.start()
    weight = _weight(_local(m.system(), t, q, v).mass)
    for part in range(1, count + 1):
        q = _closed(_held(m, {name: now[name] + (at[name] - now[name]) * part / count for name in at}), t, q, weight)
    _place(m, q, v)
    _expect_signs(m)
    driven = _held(m, {name: at.get(name, 0.0) for name in rates})
    _place(m, q, _moved(driven, t, q, v, weight, rates))


def _held(m: Any, values: dict[str, float]) -> Any:
    """A copy of ``m`` with joints held at angles or travels, by name."""
    trial = copy.copy(m)
    trial.joints, trial.rows = dict(m.joints), {name: list(rows) for name, rows in m.rows.items()}
    for name, value in values.items():
        joint = _moving_joint(m, name)
        row = (trial._travel if joint.kind == "prismatic" else trial._turn)(joint, None, value=value)
        trial.joints[f"assembled {name}"] = trial._on(joint, f"assembled {name}", "motor", [row])
    return trial


def _moving_joint(m: Any, name: str) -> Any:
    return m._find(name, "revolute", "prismatic", "cylindrical")


def _now(m: Any, name: str) -> float:
    """Angle or travel of a joint at the present pose."""
    joint = _moving_joint(m, name)
    angle, travel, _ = moves(m, *m.start())
    return float((travel if joint.kind == "prismatic" else angle)[0, list(m.joints).index(name)])


def _weight(M: Any) -> Any:
    if M.ndim == 1:
        return np.diag(M**-0.5)
    return scipy.linalg.solve_triangular(np.linalg.cholesky(M), np.eye(len(M)), lower=True).T


def _closed(m: Any, t: float, q: Any, weight: Any) -> Any:
    """Coordinates near ``q`` at which all joints hold."""
    system = m.system()
    if system.constraint is None:
        return q
    size = max(1.0, float(np.max(np.abs(q))))
    here = _local(system, t, q, q)
    for _ in range(ITERATIONS):
        if np.max(np.abs(here.g), initial=0.0) <= CLOSED * size:
            return q
        step = -weight @ np.linalg.lstsq(here.G @ weight, here.g, rcond=RANK)[0]
        for i in range(HALVINGS):
            there = _local(system, t, q + step / 2**i, q)
            if np.linalg.norm(there.g) < np.linalg.norm(here.g):
                break
        q, here = q + step / 2**i, there
    if np.max(np.abs(here.g)) <= CLOSED_ENOUGH * size:
        return q
    raise ProblemError(f"the joints cannot be brought together: {_open(m, here.g)} stay open. Give a better pose.")


def _open(m: Any, g: Any) -> str:
    return ", ".join(
        f"{name!r} ({np.max(np.abs(g[rows])):.1e})"
        for name, rows in m.rows_by_joint().items()
        if rows.size and np.max(np.abs(g[rows])) > OPEN
    )


def _moved(m: Any, t: float, q: Any, v: Any, weight: Any, rates: dict[str, float]) -> Any:
    """Velocities near ``v`` that all joints allow, with ``rates`` of joints that ``m`` holds."""
    here = _local(m.system(), t, q, v)
    parts, rests = [], []
    if here.G is not None:
        rest, rows = here.G @ v + here.moving, m.rows_by_joint()
        for name, rate in rates.items():
            rest[rows[f"assembled {name}"]] -= rate
        parts, rests = [here.G], [rest]
    if here.K is not None:
        parts, rests = [*parts, here.K], [*rests, here.k]
    if not parts:
        return v
    C, rest = np.concatenate(parts), np.concatenate(rests)
    found = v - weight @ np.linalg.lstsq(C @ weight, rest, rcond=RANK)[0]
    left = C @ found - (C @ v - rest)
    if np.max(np.abs(left)) > OPEN * max(1.0, float(np.max(np.abs(found)))):
        names = _open(m, left)
        raise ProblemError(f"no velocities agree with all rates and joints: {names or 'rolling or a prescribed rate'}.")
    return found


def _place(m: Any, q: Any, v: Any) -> None:
    """Store coordinates and velocities as poses of the bodies."""
    R, rates = along("placed", m.frame, q[None]).R[0], along("rates", m.frame, q[None], v[None])[0]
    parts, moving = np.reshape(q, (-1, m.frame.size)), np.reshape(v, (-1, m.frame.size))
    for i, body in enumerate(m.bodies.values()):
        body.x, body.velocity, body.rate = parts[i, : m.dimension], moving[i, : m.dimension], np.asarray(rates[i])
        body.R, body.angle = np.asarray(R[i]), float(parts[i, 2]) if m.plane else 0.0


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
