r"""Wagons in a row with buffers and slack draw hooks: one rolls into the others, which stand, and the gaps close one by one.

Source: contact of Hunt and Crossley, J. Appl. Mech. 42 (1975) 440-445, in buffers and hooks; the train is of this bench::

        speed -->
      [ wagon 1 ]=|        |=[ wagon 2 ]=| |=[ wagon 3 ] ...       x_i: displacement of wagon i from its place [m], i = 1..N
     ---o-----o---------------o-----o---------o-----o--------
              gap of buffers d_i = room_i + x_(i+1) - x_i,  room_1 = run, else slack / 2
              gap of hooks       e_i = slack - d_i

A buffer pushes with ``N(d)`` where d < 0, a hook pulls with ``N(e)`` where d > slack; both ``k s^exponent (1 + 1.5 c s')``
of the smooth depth s of ``hhtbench.mechanics.contact``.  The first wagon rolls at ``speed``, the others stand.  Momentum
is kept; energy falls by what buffers and hooks lose.  No closed solution.  SI units.
"""

from __future__ import annotations

import functools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics import contact, forces
from hhtbench.mechanics.lines import box_lines, ground_lines
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "Hunt and Crossley, J. Appl. Mech. 42 (1975) 440-445; the train is of this bench"
LARGE = 100  # coordinates from which the tag "large" is set: dense linear algebra stops being the best choice about here
PITCH = 12.0  #: distance of wagons in the drawing [m]


class Train(System):
    """``q`` (N,): displacements [m]; scalar mass, no constraints."""

    m: Array = parameter(4e4, doc="mass of a wagon [kg]")
    k: Array = parameter(2e7, doc="stiffness of the buffers and of the hook between two wagons [N/m^exponent]")
    c: Array = parameter(0.3, doc="loss of a buffer or hook [s/m]: an impact at u keeps 1 - c u of its speed")
    exponent: Array = parameter(1.5, doc="of the force over the depth [1]")
    slack: Array = parameter(0.04, doc="way between hook and buffers [m]")
    run: Array = parameter(0.5, doc="way of the first wagon to the second [m]")
    onset: Array = parameter(1e-3, doc="gap over which a contact sets in [m]")
    n_wagons: int = eqx.field(static=True, default=8)

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: scalar [kg]: the same for every wagon."""
        return self.m

    @property
    def law(self) -> Any:
        """Law of buffers and hooks."""
        return contact.hunt_crossley(self.k, self.c, self.onset, self.exponent)

    def gaps(self, q: Array) -> Array:
        """Gaps (2 N - 3,) [m]: of the buffers, and of the hooks behind the second wagon; the first is not coupled."""
        room = jnp.where(np.arange(self.n_wagons - 1) == 0, self.run, self.slack / 2)
        buffers = room + jnp.diff(q)
        return jnp.concatenate([buffers, self.slack - buffers[1:]])

    def pushes(self, q: Array, v: Array) -> Array:
        """Forces (2 N - 3,) [N] of buffers and hooks."""
        return -self.law(*forces.rates(self.gaps, q, v))

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: buffers and hooks, (N,) [N]."""
        return forces.force_of(self.gaps, self.law, q, v)

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy and that of buffers and hooks [J]."""
        return self.m * jnp.sum(v**2) / 2 + contact.contact_energy(self.gaps(q), self.k, self.onset, self.exponent)

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power that buffers and hooks lose [W]."""
        return forces.power_lost(self.gaps, self.law, q, v)

    def invariants(self, t: Array, q: Array, v: Array) -> dict[str, Array]:
        """Invariants: momentum [kg m/s]."""
        return {"momentum": self.m * jnp.sum(v)}


PUSHES: Any = eqx.filter_jit(Train.pushes)


def last_speed(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Velocity of the last wagon [m/s]."""
    return float(v[-1])


def largest_push(system: Train, t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Largest force of a buffer or hook [N]."""
    return float(np.max(PUSHES(system, q, v)))


def sketch(run: float, magnified: float, q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: middles of the wagons as ``points`` (N, 2), wagons and rail as ``lines`` (4 N + 6, 2, 2) [m]."""
    x = PITCH * np.arange(len(q)) + magnified * np.asarray(q)
    x[0] -= magnified * run
    rail = ground_lines((x[0] - PITCH, -2.0), (x[-1] + PITCH, -2.0), 1.0)
    wagons = [box_lines((middle, 0.0), PITCH - 1.0, 4.0) for middle in x]
    note = f"displacements are drawn {magnified:g} times"
    return {"points": np.column_stack([x, 0 * x]), "lines": np.concatenate([*wagons, rail]), "note": note}


def problem(
    *,
    n_wagons: int = 8,
    m: float = 4e4,
    k: float = 2e7,
    c: float = 0.3,
    exponent: float = 1.5,
    slack: float = 0.04,
    run: float = 0.5,
    speed: float = 1.5,
    onset: float = 1e-3,
    t_end: float = 3.0,
) -> Problem:
    """Make the problem: the train over [0, ``t_end``] [s], the impact at ``run / speed``.

    Parameters
    ----------
    n_wagons
        N, at least 2.
    m
        Mass of a wagon [kg], above 0.
    k, c
        Stiffness [N/m^exponent], above 0, and loss [s/m], at least 0, of the buffers or the hook between two wagons.
    exponent
        Of the force over the depth [1], above 1: 1.5 for Hertz's contact, larger for progressive springs.
    slack, run
        Way between hook and buffers, and way of the first wagon to the second at the start [m], above 0.
    speed
        Of the first wagon [m/s], above 0.
    onset
        Gap over which a contact sets in [m], above 0.
    """
    n = positive_integer("n_wagons", n_wagons)
    if n < 2:
        raise ProblemError(f"n_wagons must be at least 2, so that there is something to run into; got {n}.")
    values: dict[str, Any] = {
        "m": checked("m", m, above=0.0, unit="kg"),
        "k": checked("k", k, above=0.0, unit="N/m^exponent"),
        "c": checked("c", c, at_least=0.0, unit="s/m"),
        "exponent": checked("exponent", exponent, above=1.0, unit="1"),
        "slack": checked("slack", slack, above=0.0, unit="m"),
        "run": checked("run", run, above=0.0, unit="m"),
        "onset": checked("onset", onset, above=0.0, unit="m"),
    }
    speed, t_end = checked("speed", speed, above=0.0, unit="m/s"), checked("t_end", t_end, above=0.0, unit="s")
    plain = Train()
    published = n == 8 and speed == 1.5 and values == {key: float(getattr(plain, key)) for key in values}
    system = Train(**values, n_wagons=n)
    return Problem(
        name="train_buffers",
        system=system,
        t_span=(0.0, t_end),
        q0=np.zeros(n),
        v0=np.append(speed, np.zeros(n - 1)),
        scales=Scales(q=1.0, v=speed),
        observables={"last_speed": last_speed, "largest_push": functools.partial(largest_push, system)},
        reference=load_reference("train_buffers", t_end) if published else None,
        sketch=functools.partial(sketch, values["run"], PITCH / 5),
        tags=("unconstrained", "damped", "contact", *(("large",) if n >= LARGE else ())),
        good_for="contacts that open and close one after the other, between them free motion: does the step follow them",
        source=SOURCE,
    )
