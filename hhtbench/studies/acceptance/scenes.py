"""Scenes of the matrix that the scenes of ``hhtbench.conformance`` do not have, and how a row looks at an end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.conformance.scenes.pendulum import numpy_pendulum, pendulum
from hhtbench.conformance.scenes.scene import SPAN, Scene
from hhtbench.conformance.subject import Declined

PENDULUM = pendulum()  # compiled
PLAIN = numpy_pendulum()  # functions in Python


class Rod(hb.System):
    """The unit pendulum in its plane: two coordinates, one constraint."""

    gravity: Any = hb.parameter(9.81, doc="[m/s^2]")
    length: Any = hb.parameter(1.0, doc="[m]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Weight."""
        return jnp.stack([0.0 * self.gravity, -self.gravity])

    def constraint(self, t: Any, q: Any) -> Any:
        """The rod."""
        return jnp.stack([(q @ q - self.length**2) / 2.0])


Q0 = np.array([np.sin(1.0), -np.cos(1.0)])
V0 = 0.5 * np.array([np.cos(1.0), np.sin(1.0)])


def problem(system: Any, q0: Any, v0: Any, t_span: tuple[float, float] = SPAN, name: str = "scene") -> hb.Problem:
    """A problem of this study."""
    return hb.Problem(name=name, system=system, q0=q0, v0=v0, t_span=t_span)


def plane(**functions: Any) -> hb.NumpySystem:
    """The unit pendulum in its plane as plain functions, some of them replaced."""
    given: dict[str, Any] = {
        "force": lambda t, q, v: np.array([0.0, -9.81]),
        "constraint": lambda t, q: np.array([(q @ q - 1.0) / 2.0]),
        "constraint_jacobian": lambda t, q: np.array([[q[0], q[1]]]),
        "force_jacobians": lambda t, q, v: (np.zeros((2, 2)), np.zeros((2, 2))),
    }
    return hb.NumpySystem(**{**given, **functions})


def over(scene: Scene, t0: float, t1: float) -> hb.Problem:
    """The scene's problem over another interval, without its closed solution."""
    return replace(scene.problem, t_span=(t0, t1), exact=None)


def off(scene: Scene, solution: hb.Solution) -> float:
    """Largest error of q at the rows, from the closed solution [m]."""
    if not solution.success:
        return np.inf
    return max(float(np.abs(q - scene.exact(float(t)).q).max()) for t, q in zip(solution.t, solution.q, strict=True))


def ends(solution: hb.Solution, *expected: hb.Status, words: tuple[str, ...] = ()) -> str:
    """The fault of an end: "" where the status is one of those ``expected`` and message or diagnosis have the words."""
    if solution.status not in expected:
        return f"ends with {solution.status.label}: {solution.message[:90]}"
    text = f"{solution.message} {solution.diagnose()}" if words else ""
    missing = [word for word in words if word not in text]
    return f"{solution.status.label} does not name {', '.join(missing)}: {solution.message[:90]}" if missing else ""


def refuses(call: Callable[[], Any], *words: str, kinds: tuple[type[BaseException], ...] = (ValueError, TypeError)) -> str:
    """The fault of a refusal: "" where ``call`` raises one of ``kinds`` with one of the ``words``."""
    try:
        call()
    except Declined:
        raise
    except kinds as error:
        return "" if not words or any(word in str(error) for word in words) else f"{type(error).__name__}: {str(error)[:90]}"
    return "accepted"


def never(*arguments: Any) -> Any:
    """A function that must not be called."""
    raise AssertionError("a function of the system was called")


def same(one: hb.Solution, other: hb.Solution) -> bool:
    """Whether two solutions are equal bit by bit."""
    return all(getattr(one, x).tobytes() == getattr(other, x).tobytes() for x in ("t", "q", "v", "lam", "mu"))


def apart(one: hb.Solution, other: hb.Solution) -> float:
    """Largest difference of q and v at the last rows; infinite where one did not arrive."""
    if not (one.success and other.success):
        return np.inf
    return float(max(np.abs(one.q[-1] - other.q[-1]).max(), np.abs(one.v[-1] - other.v[-1]).max()))
