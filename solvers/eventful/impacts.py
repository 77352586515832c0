"""Impacts: the velocities after one, and its impulse."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp

from hhtbench.lowering import Dynamics, unreduced
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.events import Event
from hhtbench.solution.phases import Impact
from solvers._projection import Projection, closest
from solvers._start import of_dynamics
from solvers.eventful.steps import Point
from solvers.hht.events.event import number_of

ROUNDOFF = 1e-9  # impulses below this part of the largest do not pull
INCREMENT = float(np.finfo(np.float64).eps) ** (1 / 3)  # of differences, over the size of q


def gradient(event: Event, t: float, q: Vector, v: Vector) -> tuple[float, Vector]:
    """Derivatives of the event's distance by time and by q (n,); by central differences where JAX cannot trace it.

    Raises
    ------
    ProblemError
        The distance depends on v, or not on q.
    """

    def distance(t: Any, q: Any, v: Any) -> Any:
        return jnp.asarray(event.function(t, q, v), dtype=float)

    try:
        by_time, by_q, by_v = jax.grad(distance, (0, 1, 2))(t, jnp.asarray(q), jnp.asarray(v))
    except Exception:  # noqa: BLE001 - a function for numbers may raise anything when it meets a tracer
        by_time, by_q, by_v = _differences(event, t, q, v)
    if np.any(by_v) or not np.any(by_q):
        what = "depends on v" if np.any(by_v) else "does not depend on q"
        raise ProblemError(f"event {event.name!r} has a restitution: its function is a distance, of t and q; it {what}.")
    return float(by_time), np.asarray(by_q)


def _differences(event: Event, t: float, q: Vector, v: Vector) -> tuple[float, Vector, Vector]:
    d, e = (INCREMENT * max(1.0, float(np.max(np.abs(x)))) for x in (q, v))
    unit = np.eye(q.size)
    by_q = [(number_of(event, t, q + d * x, v) - number_of(event, t, q - d * x, v)) / (2 * d) for x in unit]
    by_v = [number_of(event, t, q, v + e * x) - number_of(event, t, q, v - e * x) for x in unit]
    return (number_of(event, t + d, q, v) - number_of(event, t - d, q, v)) / (2 * d), np.array(by_q), np.array(by_v)


def rebound(hit: Sequence[tuple[Event, int]], dynamics: Dynamics, place: Point) -> tuple[Vector, Impact | None]:
    """Velocities (n,) after simultaneous impacts on the distances d of events, and their Impact; None if none closes.

    ``hit``: events with the signs of their distances before.  The impulses act along the gradients N of the distances and
    on the constraints C, which go on to hold: ``M dv = -C^T L - N^T l``, ``C dv = 0``,
    ``N dv = -(1 + restitution) (N v + d_t)``.  Distances that open, and those that would pull, take no part.
    """
    known = [(event, side, *gradient(event, place.t, place.q, place.v)) for event, side in hit]
    part = [one for one in known if (one[3] @ place.v + one[2]) * one[1] < 0.0]
    rows: Any = of_dynamics(dynamics).levels.at(place.t, place.q, place.v).rows
    while part:
        normals = np.array([side * normal for _, side, _, normal in part])
        rates = np.array([side * (normal @ place.v + by_time) for _, side, by_time, normal in part])
        shares = np.array([1.0 + float(event.restitution or 0.0) for event, *_ in part])
        full = isinstance(rows, np.ndarray)
        stacked: Any = np.vstack([rows, normals]) if full else sp.vstack([rows, sp.csr_array(normals)], format="csr")
        value = np.concatenate([np.zeros(stacked.shape[0] - len(part)), shares * rates])
        v = place.v + closest(Projection(dynamics).mass(place.t, place.q), stacked, np.zeros(place.v.size), value)
        impact = impact_of(", ".join(event.name for event, *_ in part), dynamics, place, v, normals)
        if not (pulling := impact.contact < -ROUNDOFF * np.max(np.abs(impact.contact))).any():
            return v, impact
        part = [one for one, pulls in zip(part, pulling, strict=True) if not pulls]
    return place.v, None


def impact_of(name: str, dynamics: Dynamics, place: Point, v: Vector, normals: Any = ()) -> Impact:
    """The Impact that leads from ``place`` to velocities ``v`` (n,), with multipliers of least norm."""
    whole = unreduced(dynamics)
    impulse = Projection(dynamics).mass(place.t, place.q) @ (v - place.v)
    rows: Any = of_dynamics(whole).levels.at(place.t, place.q, v).rows
    rows = rows if isinstance(rows, np.ndarray) else rows.toarray()
    found = np.linalg.lstsq(np.concatenate([rows, -np.reshape(normals, (-1, v.size))]).T, -impulse)[0]
    lam, mu, contact = np.split(found, [whole.structure.m, len(rows)])
    return Impact(t=place.t, event=name, impulse=impulse, lam=lam, mu=mu, contact=contact)
