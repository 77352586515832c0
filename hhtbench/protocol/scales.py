"""Typical sizes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Scales:
    """Typical sizes of q, v, lam, mu, states x and inputs u that scale errors and drift: one number each or one per
    component.
    """

    q: Any = 1.0
    v: Any = 1.0
    lam: Any = 1.0
    mu: Any = 1.0
    x: Any = 1.0
    u: Any = 1.0


class Unscaled(Scales):
    """Scales of a problem that declares none; a class of its own, which copies and pickles keep."""


UNSCALED = Unscaled()
