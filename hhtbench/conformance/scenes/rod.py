"""The scene of most rows: a rod in its plane, compiled and as plain functions, which may be spoiled or raise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.conformance.scenes.scene import SPAN


class Rod(hb.System):
    """The unit pendulum in its plane: two coordinates, one constraint."""

    gravity: Any = hb.parameter(9.81, doc="[m/s^2]")
    length: Any = hb.parameter(1.0, doc="[m]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Applied force: weight."""
        return jnp.stack([0.0 * self.gravity, -self.gravity])

    def constraint(self, t: Any, q: Any) -> Any:
        """Position constraints: the rod."""
        return jnp.stack([(q @ q - self.length**2) / 2.0])


Q0 = np.array([np.sin(1.0), -np.cos(1.0)])
V0 = 0.5 * np.array([np.cos(1.0), np.sin(1.0)])
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "force": lambda t, q, v: np.array([0.0, -9.81]),
    "mass_matrix": lambda t, q: np.eye(2),
    "constraint": lambda t, q: np.array([(q @ q - 1.0) / 2.0]),
    "constraint_jacobian": lambda t, q: np.array([[q[0], q[1]]]),
}
PLACES = {"force": "[1]", "mass_matrix": "[1, 1]", "constraint": "[0]", "constraint_jacobian": "[0, 1]"}
STIFFNESS = np.array([[3e4, 1e4], [-2e4, 5e4]])  # not symmetric: its transpose is another matrix [1/s^2]
DAMPING = np.array([[3.0, 1.0], [-2.0, 5.0]])  # [1/s]
REST = np.array([0.6, -0.9])


def problem(system: Any, t_span: Any = SPAN, *, q0: Any = Q0, v0: Any = V0, name: str = "scene") -> hb.Problem:
    """Make a problem of ``system`` from the start of the rod."""
    return hb.Problem(name=name, system=system, q0=q0, v0=v0, t_span=t_span)


def plane(**functions: Any) -> hb.NumpySystem:
    """The unit pendulum in its plane as plain callables, some of them replaced by ``functions``."""
    given: dict[str, Any] = {name: function for name, function in FUNCTIONS.items() if name != "mass_matrix"}
    given["force_jacobians"] = lambda t, q, v: (np.zeros((2, 2)), np.zeros((2, 2)))
    return hb.NumpySystem(**{**given, **functions})


def spoiled(name: str, bad: float | BaseException, when: Callable[..., bool]) -> hb.NumpySystem:
    """The plane pendulum whose function ``name`` returns ``bad``, or raises it, when ``when(t, number of the call)`` is
    true.
    """
    calls = [0]

    def function(t: float, *arguments: Any) -> Any:
        calls[0] += 1
        value = FUNCTIONS[name](t, *arguments)
        if not when(t, calls[0]):
            return value
        if isinstance(bad, BaseException):
            raise bad
        value[(-1,) * value.ndim] = bad
        return value

    return plane(**{**FUNCTIONS, name: function})


def mutating(which: int) -> hb.NumpySystem:
    """The plane pendulum whose force changes q (0) or v (1) in place."""

    def force(t: float, *state: Any) -> Any:
        state[which][0] = 7.0
        return np.array([0.0, -9.81])

    return plane(force=force)


def claiming(change: Any) -> hb.NumpySystem:
    """The pendulum on stiff springs with its declared force Jacobians changed."""

    def force(t: float, q: Any, v: Any) -> Any:
        stretch = q - REST
        return -STIFFNESS @ (stretch + stretch**3) - DAMPING @ v

    def jacobians(t: float, q: Any, v: Any) -> Any:
        return change(-STIFFNESS * (1.0 + 3.0 * (q - REST) ** 2)), change(-DAMPING)

    return plane(force=force, force_jacobians=jacobians)


def two_rods() -> hb.NumpySystem:
    """The plane pendulum with a second rod of another length: no position meets both."""
    return plane(
        constraint=lambda t, q: np.array([q @ q - 1, q @ q - 1.21]) / 2, constraint_jacobian=lambda t, q: np.stack([q, q])
    )


def never(*arguments: Any) -> Any:
    """A function that must not be called."""
    raise AssertionError("a function of the system was called")


UNCALLED = hb.NumpySystem(force=never, constraint=never)
MASSLESS = hb.NumpySystem(mass_matrix=[1.0, 0.0], force=FUNCTIONS["force"])  # its second coordinate has no mass
SLIGHTLY_WRONG = {"90 %": lambda x: 0.9 * x, "110 %": lambda x: 1.1 * x, "twice": lambda x: 2.0 * x}
ALTOGETHER_WRONG = {"sign": lambda x: -x, "zero": lambda x: 0.0 * x, "transposed": lambda x: x.T, "1e6": lambda x: 1e6 * x}
