"""What only error control can do: steps shrink where a force begins within a thousandth of the interval, and grow again."""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.integrate import quad

from hhtbench.conformance.entry import claim
from hhtbench.conformance.subject import Subject, expect
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import System

BEGINS, WITHIN = 0.53, 1e-3  # [s]
SIZE = 100.0  # [m/s^2]
GROWN = 10.0  # a second after steps of a thousandth no method needs them any more


class Pushed(System):
    """A bead on the x axis, pushed from ``BEGINS`` on."""

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Applied force: along the axis."""
        return jnp.array([SIZE / 2, 0.0]) * (1.0 + jnp.tanh((t - BEGINS) / WITHIN))

    def constraint(self, t: Any, q: Any) -> Any:
        """Position constraints: the bead stays on it."""
        return q[1:]


def _speed(t: float) -> float:
    """Exact speed of the bead from rest [m/s]."""
    s, s0 = (t - BEGINS) / WITHIN, -BEGINS / WITHIN
    return SIZE / 2 * (t + WITHIN * (_log_cosh(s) - _log_cosh(s0)))


def _log_cosh(s: float) -> float:
    return abs(s) + math.log1p(math.exp(-2 * abs(s))) - math.log(2.0)


PROBLEM = Problem(name="onset", system=Pushed(), t_span=(0.0, 1.0), q0=np.zeros(2), v0=np.zeros(2))


@claim("tolerance/growth", needs=("rtol",))
def steps_grow_again(subject: Subject) -> None:
    """After a force has begun, steps become long again: its onset takes short ones, the steady force does not."""
    lengths = np.diff(subject.succeeds(PROBLEM, **subject.ladder(PROBLEM)[1]).t)[:-1]  # the last one lands at the end
    grown = float(np.max(lengths[np.argmin(lengths) :]) / np.min(lengths))
    expect(
        grown >= GROWN, f"the longest step after the onset is {grown:.1f} times the shortest; expected {GROWN:g} at least"
    )


@claim("tolerance/onset", needs=("rtol",))
def sudden_force_is_resolved(subject: Subject) -> None:
    """A force that begins at once costs no more than the tolerance: the step across its onset is taken back."""
    place = quad(_speed, 0.0, 1.0, points=[BEGINS], epsabs=0.0, epsrel=1e-10)[0]
    for request in subject.ladder(PROBLEM)[1:]:
        solution = subject.succeeds(PROBLEM, **request)
        found, wanted = (solution.q[-1, 0], solution.v[-1, 0]), (place, _speed(1.0))
        error = max(abs(one - other) / other for one, other in zip(found, wanted, strict=True))
        bound = subject.bound(request, PROBLEM)
        text = f"the error at rtol={request['rtol']:g} is {error:.1e}; expected {bound:.1e} at most"
        expect(error <= bound, text)
