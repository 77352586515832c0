"""Scenes of the study: a point on a spring with one part more each, and a chain that every reduction fits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.protocol.arguments import Vector

GRAVITY = 9.81
H = 0.01  # [s] of prescribed steps
FOREVER = 1e4  # [s], which no run reaches that is ended by its number of steps


class Spring(hb.System):
    """A unit mass that falls on a spring which stiffens: a force and nothing else."""

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """F (3,) [N]."""
        return jnp.array([0.0, 0.0, -GRAVITY]) - (1.0 + q @ q) * q


def spring(**functions: Any) -> hb.System:
    """The point with further functions of ``(self, t, q, ...)``."""
    return type("Spring", (Spring,), functions)()


def _on_sphere(radius: Callable[[Any], Any]) -> Callable[..., Any]:
    return lambda self, t, q: jnp.stack([(q @ q - radius(t) ** 2) / 2.0])


def _energy(self: Any, t: Any, q: Any, v: Any) -> Any:
    return 0.5 * (v @ v) + GRAVITY * q[2] + 0.5 * (q @ q) + 0.25 * (q @ q) ** 2


FREE = spring()
HELD = spring(constraint=_on_sphere(lambda t: 1.0))
CONSTANT_MASS = spring(mass_matrix=np.array([[2.0, 0.3, 0.0], [0.3, 1.0, 0.1], [0.0, 0.1, 1.5]]))
VARIABLE_MASS = spring(mass_matrix=lambda self, t, q: jnp.diag(1.0 + 0.3 * q**2))
DAMPED = spring(force=lambda self, t, q, v: Spring.force(self, t, q, v) - 0.2 * v)
BREATHING = spring(constraint=_on_sphere(lambda t: 1.0 + 0.1 * jnp.sin(t)))
SKATE = spring(velocity_constraint=lambda self, t, q, v: jnp.stack([v[2] - 0.2 * q[1] * v[0]]))
CUBIC = spring(constraint=_on_sphere(lambda t: 1.0), reaction=lambda self, t, q, lam: -q * (lam[0] + 1e-3 * lam[0] ** 3))
MEASURED = spring(  # by functions that no solver uses
    energy=_energy,
    power=lambda self, t, q, v, lam, mu: jnp.zeros(()),
    invariants=lambda self, t, q, v: {"about the vertical": q[0] * v[1] - q[1] * v[0]},
)


class Chain(hb.System):
    """Points on a line between springs that stiffen, the first two of them held on a circle."""

    mass_matrix: Any = hb.parameter(1.0, doc="[kg]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """F (n,) [N]."""
        stretch, end = jnp.diff(q), jnp.zeros(1)
        return jnp.concatenate([stretch, end]) - jnp.concatenate([end, stretch]) - q - q**3

    def constraint(self, t: Any, q: Any) -> Any:
        """g (1,) [m^2]."""
        return jnp.stack([(q[0] ** 2 + q[1] ** 2 - 1.0) / 2.0])


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What is solved: a system with its start, and what is asked of HHT."""

    system: Any
    q0: Vector = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    v0: Vector = field(default_factory=lambda: np.array([0.0, 0.5, 0.0]))
    rows: str = "last"  #: of output: the "last", one "between" the ends of every step, or "steps", dense output with them
    controlled: bool = False  #: whether by error control, not by prescribed steps
    uneven: bool = False  #: whether two lengths of prescribed steps alternate, so that each has a matrix of its own
    watched: bool = False  #: whether an event is looked for, which is recorded
    options: dict[str, Any] = field(default_factory=dict)

    def request(self, steps: int) -> tuple[tuple[float, float], dict[str, Any]]:
        """Interval [s] and request of a run of so many steps."""
        if self.controlled:
            return (0.0, FOREVER), {"rtol": 1e-4, "max_num_steps": steps, "t_eval": np.array([FOREVER])}
        end = steps * H
        times = {"last": np.array([end]), "between": H * (np.arange(steps) + 0.5), "steps": None}
        lengths = H * np.tile([1.2, 0.8], steps // 2) if self.uneven else steps
        return (0.0, end), {"steps": lengths, "t_eval": times[self.rows]}

    def integrator(self, event: Any, system: Any = None, **options: Any) -> Any:
        """HHT for it; ``event`` (t, q, v) is looked for where one is, ``system`` takes the place of its own."""
        events = [hb.Event(event, name="height")] if self.watched else None
        return hb.HHT(system or self.system, events=events, **{**self.options, **options})


def chain(n: int, *, coupled: bool = False) -> Scene:
    """The chain of ``n`` points; ``coupled``: with a full mass matrix."""
    mass = np.eye(n) + 0.1 / (1.0 + np.abs(np.subtract.outer(np.arange(n), np.arange(n))))
    q0 = np.concatenate([[1.0], np.zeros(n - 1)])
    v0 = np.concatenate([[0.0, 0.5], 0.1 * np.cos(np.arange(n - 2))])
    return Scene(system=Chain(mass_matrix=mass) if coupled else Chain(), q0=q0, v0=v0)
