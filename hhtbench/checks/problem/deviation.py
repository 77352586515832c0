"""Deviation of a derivative from its reference, beyond the reference's own error."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hhtbench.checks.problem.reference import Probe, Reference, References, blocks
from hhtbench.protocol.arguments import Matrix, Vector

OWN_ERROR = 2.0  # deviations below this multiple of the differences' own error are ignored
USABLE = 1e-2  # share of a row's terms added to its size; differences with a larger relative error are not used


@dataclass(frozen=True)
class Derivative:
    """One derivative: the function that gives it and the block of the reference Jacobian it must equal."""

    declared_as: str  #: name under which a system may declare it, "" if it may not
    text: str  #: in symbols
    part: str
    by: str  #: argument; "motion": along (1, v)
    member: str  #: function of Dynamics that gives it
    entry: int | None = None  #: number of the result, where ``member`` returns several
    rests_on: tuple[str, ...] = ()  #: derivatives that it is made from when it is not declared
    first_order: bool = True  #: on the NumPy route it comes from first-order differences


@dataclass(frozen=True)
class Expected:
    """Reference value of a derivative with the scales and errors of its rows."""

    matrix: Matrix  #: (rows, columns)
    row_size: Matrix  #: (rows, 1) largest term of the derivative
    terms: Matrix  #: (rows, 1) size of all that enters the row's function
    scale: Vector  #: (columns,) typical size of the arguments
    error: Matrix | float = 0.0  #: (rows, columns) of the matrix itself

    @property
    def blur(self) -> float:
        """Largest error of the reference, relative to ``USABLE`` of the terms."""
        blurred = OWN_ERROR * self.error * self.scale
        size = self.row_size + USABLE * self.terms
        return float(np.max(np.where(blurred > 0, blurred / np.where(size > 0, size, 1.0), 0.0), initial=0.0))


def by_differences(derivative: Derivative, references: References, reference: Reference, state: Probe) -> Expected:
    """Return the expected derivative from differences, with their estimated error."""
    where, part = blocks(references.structure), derivative.part
    jacobian, errors = reference.differences[part], reference.errors[part]
    terms = _largest(jacobian * references.scales) + np.abs(reference.value[part])[:, None]
    if part == "constraint_velocity":  # it is a derivative of g itself
        terms = terms + _largest(reference.differences["constraint"] * references.scales)
    if derivative.by != "motion":
        own = where[derivative.by]
        scale = references.scales[own]
        return Expected(jacobian[:, own], _largest(jacobian[:, own] * scale), terms, scale, errors[:, own])
    v = state.z[where["v"]]
    parts = np.concatenate([jacobian[:, where["t"]], jacobian[:, where["q"]] * v], axis=1)
    error = errors[:, where["t"]] + (errors[:, where["q"]] @ np.abs(v))[:, None]
    return Expected(parts.sum(axis=1, keepdims=True), np.abs(parts).sum(axis=1, keepdims=True), terms, np.ones(1), error)


def of_one_size(expected: list[Expected]) -> list[Expected]:
    """Scale every row by its largest derivative and terms at any state, since they may vanish by symmetry at the start."""
    size, terms = (np.fmax.reduce([getattr(one, name) for one in expected]) for name in ("row_size", "terms"))
    return [replace(one, row_size=size, terms=terms) for one in expected]


def _largest(matrix: Matrix) -> Matrix:
    """Return the largest finite magnitude of each row, (rows, 1)."""
    return np.asarray(np.fmax.reduce(np.abs(matrix), axis=1, keepdims=True, initial=0.0), dtype=np.float64)


def deviation(given: Matrix, expected: Expected, floor: float, label: str) -> tuple[float, str]:
    """Return the largest deviation of ``given`` relative to the size of its row, and a text that names the entry."""
    matrix, size = expected.matrix, expected.row_size + floor * expected.terms
    with np.errstate(invalid="ignore", divide="ignore"):
        change = np.maximum(np.abs(given - matrix) - OWN_ERROR * expected.error, 0.0) * expected.scale
        relative = np.where(change == 0, 0.0, change / size)
    relative = np.where(np.isfinite(given) & np.isinf(expected.error), 0.0, relative)  # there are no differences
    relative = np.where(np.isnan(relative), np.inf, relative)
    if not relative.any():
        return 0.0, ""
    i, j = np.unravel_index(np.argmax(relative), relative.shape)
    entry = f"row {i}, column {j}, {label}: given {given[i, j]:.10g}, expected {matrix[i, j]:.10g}"
    return float(relative[i, j]), entry
