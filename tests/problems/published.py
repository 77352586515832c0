"""How published reference values map onto our problems.

``reference_values.json`` (strings keep more digits than a double) holds values certified elsewhere, most by extrapolation
in 113-bit arithmetic.  Its layouts differ from problem to problem: full states, tips, angles, points, quaternions with the
scalar first.  The tables of ``published_tables.py`` and ``published_chains.py`` say where each stands in a state of ours.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from hhtbench.catalogue.registry import load_problem
from tests.problems.mechanics import Mechanics, compiled

STORED = json.loads(Path(__file__).with_name("reference_values.json").read_text(encoding="utf-8"))
ABOUT = {"t", "t2", "digits_verified", "digits_quad_selfconv", "source", "note"}  # keys that describe an entry

NO_PROBLEM = {  # entries that hold no states of a problem
    "_layout": "a sentence on the other entries",
    "expected_extended_hht_errors": "errors of one method: solvers/hht/verify holds them, compared in test_published.py",
}


@dataclass(frozen=True)
class Published:
    """Where the numbers of one entry of ``reference_values.json`` are found in a state of ours."""

    spec: str  #: the problem, its interval long enough for every time
    values: Mapping[str, Callable[[Any], Any]]  #: key of the entry -> what the state (t, q, v, lam, mu, vdot) has for it
    times: Mapping[str, float] = field(default_factory=dict)  #: key -> time [s] where it is not the entry's "t"
    left_out: Mapping[str, str] = field(default_factory=dict)  #: keys that are not compared, each with its reason
    digits: int | None = None  #: that the entry confirms, where they are fewer than our reference has: its own error bar
    instead: Callable[[float], Any] | None = None  #: t -> our state where no certified reference can reach
    after: float = np.inf  #: [s], ``instead`` is compared at later times
    bar: float = 0.0  #: error of ``instead``, of the largest value of a key
    why: str = ""  #: why ``instead``


class State:
    """A state of a problem, its accelerations computed when they are asked for."""

    def __init__(self, spec, t, q, v, lam, mu):
        self.spec, self.t, self.q, self.v, self.lam, self.mu = spec, t, q, v, lam, mu

    def moved(self, name, value):
        parts = {key: getattr(self, key) for key in ("spec", "t", "q", "v", "lam", "mu")}
        return State(**parts | {name: value})

    @cached_property
    def vdot(self):
        return Mechanics(_compiled(self.spec)).accelerations(self.t, self.q, self.v)[0]


_SYSTEMS: dict[str, Any] = {}


def _compiled(spec):
    if spec not in _SYSTEMS:
        _SYSTEMS[spec] = compiled(load_problem(spec).system)
    return _SYSTEMS[spec]


def closed(spec):
    """t -> the state of the problem's closed solution."""
    return lambda t: State(spec, t, *load_problem(spec).exact(t))
