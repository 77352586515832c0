"""Helpers of scenes of rigid bodies in space that are put together by names."""

from __future__ import annotations

import dataclasses
from typing import Any

from hhtbench.mechanics.space import moment_of_momentum
from hhtbench.protocol.problem import Problem


def vertical_momentum(system: Any, q: Any, v: Any) -> Any:
    """Angular momentum [kg m^2/s] of the bodies of a mechanism in space about the z axis."""
    return moment_of_momentum(q, v, system.m, system.J)[2]


def with_j0(problem: Problem, j0: float) -> Problem:
    """Return ``problem`` of a mechanism with the inertia ``j0`` [kg m^2] along its quaternions, at least 0."""
    system: Any = problem.system
    return dataclasses.replace(problem, system=dataclasses.replace(system, j0=0 * system.m + j0))
