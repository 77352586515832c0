"""Callbacks into Python where the loops have no machine code: forces, acceleration level, branch switches."""

from __future__ import annotations

import weakref
from functools import partial
from typing import Any

from hhtbench.lowering.dynamics.callbacks import Callbacks
from solvers.hht.run.branches import Stepped, branch_switch
from solvers.kernel.kkt import acceleration_level

Codes = dict[str, tuple[int, int]]  # addresses of functions and of their parameters, by name


def python_codes(engine: Stepped, callbacks: Callbacks) -> Codes:
    """Addresses of Python functions for ``engine`` and of their parameters (0: none), by name.

    They hold a weak reference, since callbacks of a system's functions outlive the engine.
    """
    weak: Any = weakref.proxy(engine)
    s = engine.structure
    n, m, p = s.n, s.m, s.p
    inverse = n * n if s.mass == "variable" else 0
    level = callbacks.entry(partial(acceleration_level, weak), 1 + n + m + p, ((), (n,), (n,), (m,), (p,)))
    force = callbacks.entry(lambda *at: weak.bare_force(*at), n + inverse, ((), (n,), (n,)))
    leap = callbacks.entry(partial(branch_switch, weak), n, ((6 + 2 * n,), (n,), (n,), (2,)))
    return {"acceleration": (level, 0), "force": (force, 0), "leap": (leap, 0)}
