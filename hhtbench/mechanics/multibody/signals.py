"""First-order states and sampled inputs of a mechanism, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.multibody.composites import Composites
from hhtbench.mechanics.multibody.rows import OfTime, of_time
from hhtbench.protocol.arguments import real_array
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.sampled import Sampled
from hhtbench.protocol.scales import Scales

OWN = "t", "q", "v"  # what laws may take beside states and inputs


@dataclass(kw_only=True)
class Signal:
    """A state or an input: its law, its start and its typical size."""

    law: Callable[..., Any]
    start: Any
    scale: float | None = None
    every: float | None = None  #: [s] between samples; None for a state
    delay: float = 0.0


class Names(eqx.Module):
    """Places of states in ``x`` and of inputs in ``u`` by name; a slice, or a number where the value is one."""

    states: tuple[tuple[str, Any], ...] = eqx.field(static=True, default=())
    inputs: tuple[tuple[str, Any], ...] = eqx.field(static=True, default=())

    def given(self, t: Any, q: Any, v: Any, x: Any, u: Any) -> dict[str, Any]:
        """What a law may take, by name."""
        values = {"t": t, "q": q, "v": v}
        for places, vector in ((self.states, x), (self.inputs, u)):
            values |= {name: vector[slice(*place) if isinstance(place, tuple) else place] for name, place in places}
        return values


class Rates(eqx.Module):
    """Rates of states, one law after the other."""

    laws: tuple[OfTime, ...]

    def __call__(self, given: dict[str, Any]) -> Array:
        """Rates (k,)."""
        return jnp.concatenate([jnp.ravel(jnp.asarray(law(given), float)) for law in self.laws])


class Signals(Composites):
    """Bodies, joints, forces, states and inputs."""

    def state(self, name: str, rate: Callable[..., Any], start: Any = 0.0, *, scale: float | None = None) -> str:
        """First-order state, a number or (k,) from ``start``, whose rate is a function in ``jax.numpy``.

        The function takes, by these names, any of ``t``, ``q``, ``v`` and the states and inputs of the mechanism; so may
        the functions of loads and actuators.  ``scale`` is a typical size, for tolerances.
        """
        return self._signal(name, Signal(law=rate, start=real_array(f"start of {name!r}", start), scale=scale))

    def input(
        self,
        name: str,
        law: Callable[..., Any],
        *,
        every: float,
        delay: float = 0.0,
        start: Any = 0.0,
        scale: float | None = None,
    ) -> str:
        """Input that is held between samples, as that of a digital controller: see :class:`hhtbench.Sampled`.

        ``law`` takes arguments by name as the functions of states do, and returns the shape of ``start``; inputs it takes
        are those sampled last, its own by its own name.
        """
        kept = Sampled(law, every, delay, start, name)
        return self._signal(name, Signal(law=law, start=kept.start, every=every, delay=delay, scale=scale))

    def _signal(self, name: str, signal: Signal) -> str:
        self._expect_new(name)
        if name in OWN or not name.isidentifier():
            raise ProblemError(f"a state or input must have a Python name other than {', '.join(OWN)}; got {name!r}.")
        if not callable(signal.law):
            raise TypeError(f"the law of {name!r} must be a function; got {type(signal.law).__name__}.")
        if signal.scale is not None:
            self._expect_numbers(name, 0.0, scale=signal.scale)
        self.signals[name] = signal
        return name

    def _names(self) -> Names:
        kinds = [
            [(name, one.start) for name, one in self.signals.items() if (one.every is None) == state] for state in (1, 0)
        ]
        return Names(*(_places(kind) for kind in kinds))

    def _state_rates(self) -> Rates | None:
        known = (*OWN, *self.signals)
        laws = tuple(of_time(one.law, known, strict=True) for one in self.signals.values() if one.every is None)
        return Rates(laws) if laws else None  # type: ignore[arg-type]

    def _options(self, options: dict[str, Any]) -> dict[str, Any]:
        """Options of the problem: starts and typical sizes of states, and inputs."""
        states = [one for one in self.signals.values() if one.every is None]
        names, known = self._names(), (*OWN, *self.signals)
        inputs = [
            Sampled(_Law(of_time(one.law, known, strict=True), names), one.every, one.delay, one.start, name)
            for name, one in self.signals.items()
            if one.every is not None
        ]
        found: dict[str, Any] = {"inputs": inputs} if inputs else {}
        if states:
            found["x0"] = np.concatenate([np.ravel(one.start) for one in states])
        if any(one.scale is not None for one in self.signals.values()):
            sizes = {"x": states, "u": [one for one in self.signals.values() if one.every is not None]}
            more = {name: np.concatenate([np.zeros(0), *map(_sizes, some)]) for name, some in sizes.items()}
            options = options | {"scales": replace(options.get("scales", Scales()), **more)}
        return found | options


def _sizes(one: Signal) -> Any:
    return np.full(np.size(one.start), 1.0 if one.scale is None else one.scale)


class _Law:
    """The law of an input as a function of (t, q, v, x, u)."""

    def __init__(self, law: Any, names: Names) -> None:
        self._law, self._names = law, names

    def __call__(self, t: Any, q: Any, v: Any, x: Any, u: Any) -> Any:
        return self._law(self._names.given(t, q, v, x, u))


def _places(starts: list[tuple[str, Any]]) -> tuple[tuple[str, Any], ...]:
    found, at = [], 0
    for name, start in starts:
        found.append((name, at if np.ndim(start) == 0 else (at, at + start.size)))
        at += np.size(start)
    return tuple(found)
