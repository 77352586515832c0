"""Consistent starts of mechanisms from rough poses, degrees of freedom and redundant joints.

Positions: Gauss-Newton steps of least norm in the masses, ``dq = -W (G W)^+ g`` with ``M^-1 = W W^T``; velocities: one such
step.  Source: A. A. Shabana, Computational Dynamics, Wiley 2010, chapter 3; least squares by singular values.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from scipy.sparse.csgraph import connected_components

from hhtbench.mechanics.multibody.motion import moves
from hhtbench.mechanics.multibody.readings import along, coordinate_of
from hhtbench.mechanics.multibody.starts import expect_signs, slides
from hhtbench.protocol.errors import ProblemError
from hhtbench.runtime.disk_cache import use_disk_cache

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
    begins: tuple[tuple[str, float], ...] = ()  #: angles [rad] that motors of a rate start from, which nothing gave

    def __str__(self) -> str:
        text = f"{self.degrees_of_freedom} degrees of freedom"
        begins = "".join(f"; motor {name!r} starts at {angle:.6g} rad" for name, angle in self.begins)
        if not self.redundant:
            return f"{text}, no redundant rows{begins}"
        sets = "; ".join(", ".join(names) for names in self.sharing)
        return f"{text}, {self.redundant} redundant rows: these joints share their loads: {sets}{begins}"


class _Local(NamedTuple):
    """Rows, their Jacobians and the masses at one time and state; None without rows."""

    mass: Any
    g: Any
    G: Any  #: of the position rows by q
    moving: Any  #: derivative of the position rows by time
    k: Any
    K: Any  #: of the velocity rows by v


def _local(system: Any, t: float, q: Any, v: Any) -> Any:
    use_disk_cache()
    found = _compiled(system, *(np.asarray(x, float) for x in (t, q, v)))
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
    free = [name for name, joint in m.joints.items() if joint.rows and joint.rows[0][0] == "speed"]
    now = _counted(m, m.start()[0], {name: 2 * math.pi * m.joints[name].turns for name in m.joints}) if free else {}
    return replace(mobility(m), begins=tuple((name, now[name][0]) for name in free if not _given(m, name, at)))


def _given(m: Any, motor: str, at: dict[str, float]) -> bool:
    """Whether ``at`` holds the angle of the joint of a motor."""
    return any(m.joints[name].points is m.joints[motor].points for name in at)


def _assemble(m: Any, at: dict[str, float], rates: dict[str, float], t: float) -> None:
    """Approach the angles and travels ``at`` and those of motors in parts so short that turns and teeth are counted."""
    q, v = m.start()
    weight = _weight(_local(m.system(), t, q, v).mass)
    now = _counted(m, q, {name: 2 * math.pi * joint.turns for name, joint in m.joints.items()})
    goals = {name: float(at[_moving_joint(m, name).name]) for name in at} | _motors(m, t)
    begun = {name: now[name][slides(m, name)] for name in goals}
    ratios = [abs(row.more["ratio"]) for family in ("gear", "screw") for row in m.rows.get(family, [])]
    steepest = max([1.0, *ratios, *(1 / ratio for ratio in ratios)])
    count = max([1, *(math.ceil(abs(goals[name] - begun[name]) * steepest / PART) for name in goals)])
    for part in range(1, count + 1):
        values = {name: begun[name] + (goals[name] - begun[name]) * part / count for name in goals}
        q = _closed(_held(_eased(m, values, now), {name: values[name] for name in at}), t, q, weight)
        now = _counted(m, q, {name: angle for name, (angle, _) in now.items()})
    _place(m, q, v)
    expect_signs(m)
    driven = _held(m, {name: now[name][slides(m, name)] for name in rates})
    _place(m, q, _moved(driven, t, q, v, weight, rates))
    shown = _counted(m, q, dict.fromkeys(m.joints, 0.0))
    for name, joint in m.joints.items():
        joint.turns = round((now[name][0] - shown[name][0]) / (2 * math.pi))


def _counted(m: Any, q: Any, near: dict[str, float]) -> dict[str, tuple[float, float]]:
    """Angle and travel of every joint by name; in space the angles within half a turn of ``near``."""
    angle, travel, *_ = moves(m, q, q) if m.joints else (np.zeros((1, 0)),) * 4
    turns = [0 if m.plane else round((near[name] - a) / (2 * math.pi)) for name, a in zip(m.joints, angle[0], strict=True)]
    found = {
        name: (float(a) + 2 * math.pi * k, float(s))
        for name, a, k, s in zip(m.joints, angle[0], turns, travel[0], strict=True)
    }
    measured = {name: joint.measured for name, joint in m.joints.items() if joint.measured is not None}
    values = {name: float(coordinate_of(m, kind, row, q[None], q[None])[0][0]) for name, (kind, row) in measured.items()}
    return found | {name: (value, value) for name, value in values.items()}


def _motors(m: Any, t: float) -> dict[str, float]:
    """Angles or travels at time ``t`` that motors prescribe, by name."""
    found = {name: m.rows[joint.rows[0][0]][joint.rows[0][1]] for name, joint in m.joints.items() if joint.kind == "motor"}
    return {name: float(row.law(t)) for name, row in found.items() if m.joints[name].rows[0][0] != "speed"}


def _eased(m: Any, values: dict[str, float], now: dict[str, tuple[float, float]]) -> Any:
    """A copy of ``m`` whose motors hold ``values`` and whose gears know the turns of their angles ``now``."""
    trial = _copied(m)
    for name in values:
        joint = m.joints[name]
        if joint.kind != "motor":
            continue
        family, number = joint.rows[0]
        (trial._travel if family == "slide" else trial._turn)(joint, None, value=values[name])
        trial.rows[family][number] = trial.rows[family].pop()
    trial.rows["couple"] = [replace(row, more=row.more | {"teeth": 1}) for row in m.rows.get("couple", [])]
    for family in ("gear", "screw") if not m.plane else ():
        for part in (family, f"{family} other"):
            for i, row in enumerate(m.rows.get(part, [])):
                joint = m.rows[family][i].more["joints"][part != family]
                if part != "screw other":
                    trial._turn(joint, None, part, value=now[joint.name][0])
                    trial.rows[part][i] = trial.rows[part].pop()
                    trial.rows[part][i].more = row.more | {"counted": True}
    return trial


def _held(m: Any, values: dict[str, float]) -> Any:
    """A copy of ``m`` with joints held at angles or travels, by name."""
    trial = _copied(m)
    for name, value in values.items():
        joint = _moving_joint(m, name)
        if joint.measured is not None:
            trial.couple(f"assembled {name}", name, None, [value])
            continue
        row = (trial._travel if joint.kind == "prismatic" else trial._turn)(joint, None, value=value)
        trial.joints[f"assembled {name}"] = trial._on(joint, f"assembled {name}", "motor", [row])
    return trial


def _copied(m: Any) -> Any:
    """A copy of ``m`` to which rows can be added."""
    trial = copy.copy(m)
    trial.joints, trial.rows = dict(m.joints), {name: list(rows) for name, rows in m.rows.items()}
    return trial


def _moving_joint(m: Any, name: str) -> Any:
    return m._find(name, "revolute", "prismatic", "cylindrical", "hinge", "slide", "tilt")


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
