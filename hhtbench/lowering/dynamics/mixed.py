"""Derivatives of forces whose geometric part has tensions predicted from the iterate before: mixed Newton, (H61).

Full Newton iteration takes the geometric stiffness at the tensions of the iterate.  Where stretching is far stiffer than
bending, a turn by a first-order increment feigns a stretch, and tensions that are not there enter the matrix.

Source: D. Magisano, L. Leonetti, G. Garcea, Int. J. Numer. Meth. Engng 109 (2017), 1237-1262.
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Any, NamedTuple

import jax
import numpy as np

from hhtbench.lowering.dynamics.dynamics import Dynamics
from hhtbench.mechanics.forces import tensions_given, tensions_of


class Predicted(NamedTuple):
    """Where tensions are evaluated, and the changes along which they are continued."""

    t: Any  #: [s]
    q: Any  #: (n,)
    v: Any  #: (n,)
    change_q: Any  #: (n,)
    change_v: Any  #: (n,)


def mixed(dynamics: Dynamics, place: Predicted) -> AbstractContextManager[None]:
    """Context in which derivatives of ``dynamics.force`` take the tensions predicted from ``place``.

    It changes nothing where the system calls :func:`~hhtbench.mechanics.forces.force_of` nowhere.  Calls inside of a
    ``vmap``, ``jit``, ``cond``, loop or derivative of the system's own keep their plain derivative.
    """

    def tensions(q: Any, v: Any) -> tuple[Any, ...]:
        return tensions_of(lambda: dynamics.force(place.t, q, v))

    if dynamics.xp is np or not _collected(tensions, place):
        return nullcontext()
    at = jax.lax.stop_gradient(place)
    values, changes = jax.jvp(tensions, (at.q, at.v), (at.change_q, at.change_v))
    return tensions_given([value + change for value, change in zip(values, changes, strict=True)])


def _collected(tensions: Any, place: Predicted) -> bool:
    """True if there are tensions, and all are computed at the level of the force itself."""
    try:
        with jax.checking_leaks():
            return len(jax.eval_shape(tensions, place.q, place.v)) > 0
    except Exception as error:
        if "Leaked trace" not in str(error):
            raise
        return False
