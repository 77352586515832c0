"""Impacts: the velocities after one, and its impulse."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp

from hhtbench.lowering import Dynamics, unreduced
from hhtbench.protocol.arguments import Vector
from hhtbench.solution.result import Impact
from solvers._projection import Projection, closest
from solvers._start import of_dynamics
from solvers.eventful.steps import Point
from solvers.hht.events.event import Event, number_of

INCREMENT = float(np.finfo(np.float64).eps) ** (1 / 3)  # of differences, over the size of q


def gradient(event: Event, t: float, q: Vector, v: Vector) -> tuple[float, Vector]:
    """Derivatives of the event's distance by time and by q (n,); by central differences where JAX cannot trace it."""

    def distance(t: Any, q: Any) -> Any:
        return jnp.asarray(event.function(t, q, jnp.asarray(v)), dtype=float)

    try:
        by_time, by_q = jax.grad(distance, (0, 1))(t, jnp.asarray(q))
    except Exception:  # noqa: BLE001 - a function for numbers may raise anything when it meets a tracer
        d = INCREMENT * max(1.0, float(np.max(np.abs(q))))
        both = [(number_of(event, t, q + e, v) - number_of(event, t, q - e, v)) / (2 * d) for e in d * np.eye(q.size)]
        by_time = (number_of(event, t + d, q, v) - number_of(event, t - d, q, v)) / (2 * d)
        by_q = np.array(both)
    return float(by_time), np.asarray(by_q)


def rebound(event: Event, declared: Event, dynamics: Dynamics, place: Point) -> tuple[Vector, Vector]:
    """Velocities (n,) after an impact of the ``event``'s restitution, and the gradient n (n,) of its distance d.

    The impulses act along that gradient and on the constraints C, which go on to hold:
    ``M dv = -C^T L - n l``, ``C dv = 0``, ``n dv = -(1 + restitution) (n v + d_t)``.
    """
    by_time, normal = gradient(declared, place.t, place.q, place.v)
    rows: Any = of_dynamics(dynamics).levels.at(place.t, place.q, place.v).rows
    last: Any = normal[None]
    stacked: Any = np.vstack([rows, last]) if isinstance(rows, np.ndarray) else sp.vstack([rows, last], format="csr")
    value = np.zeros(stacked.shape[0])
    value[-1] = (1.0 + float(event.restitution or 0.0)) * (normal @ place.v + by_time)
    return place.v + closest(Projection(dynamics).mass(place.t, place.q), stacked, np.zeros(place.v.size), value), normal


def impact_of(name: str, dynamics: Dynamics, place: Point, v: Vector, normal: Vector | None = None) -> Impact:
    """The Impact that leads from ``place`` to velocities ``v`` (n,), with multipliers of least norm."""
    whole = unreduced(dynamics)
    impulse = Projection(dynamics).mass(place.t, place.q) @ (v - place.v)
    rows: Any = of_dynamics(whole).levels.at(place.t, place.q, v).rows
    rows = rows if isinstance(rows, np.ndarray) else rows.toarray()
    if normal is not None:
        rows = np.vstack([rows, -normal])
    found = np.linalg.lstsq(rows.T, -impulse)[0]
    s = whole.structure
    contact = float(found[-1]) if normal is not None else 0.0
    return Impact(t=place.t, event=name, impulse=impulse, lam=found[: s.m], mu=found[s.m : s.m + s.p], contact=contact)
