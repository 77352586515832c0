"""Closed forms of one step on an oscillator, all from the characteristic polynomial of (H18)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hhtbench.arguments import Matrix
from solvers.hht.verify.local import closed_invariants

Spectrum = NDArray[np.complex128]


@dataclass(frozen=True)
class Swing:
    """How a vibration decays and how much too long its period is."""

    damping: float  #: ratio xi
    elongation: float  #: of the period 2 pi / w, relative


def roots(alpha: float, frequency: float, zeta: float) -> Spectrum:
    """The three eigenvalues in closed form, complex: roots of the characteristic polynomial of (H18)."""
    trace, minors, determinant = closed_invariants(alpha, frequency, zeta)
    return np.roots([1.0, -trace, minors, -determinant]).astype(np.complex128)


def swing_of(eigenvalues: Spectrum, frequency: float) -> Swing:
    """Damping ratio and elongation of the vibration with the given eigenvalues at w h = ``frequency``."""
    principal = np.log(max(eigenvalues, key=lambda root: root.imag))
    return Swing(float(-principal.real / abs(principal)), float(frequency / principal.imag - 1.0))


def series(alpha: float, frequency: float) -> Swing:
    """The leading terms of both in w h for zeta = 0, from the logarithm of the principal root of (H18)."""
    damping = -alpha * (1.0 + alpha) ** 2 * frequency**3 / 8.0
    return Swing(damping, frequency**2 * (2.0 - 6.0 * alpha - 9.0 * alpha**2) / 24.0)


def spectrum(matrix: Matrix) -> Spectrum:
    """Its eigenvalues, complex also where they are real."""
    return np.linalg.eigvals(matrix).astype(np.complex128)


def radius(eigenvalues: Spectrum) -> float:
    """Largest magnitude."""
    return float(np.max(np.abs(eigenvalues)))


def invariants_error(measured: Matrix, alpha: float, frequency: float, zeta: float) -> float:
    """Largest error of trace, sum of principal minors and determinant (3, 3), each over the larger of one and its value."""
    a = measured
    minors = sum(a[i, i] * a[j, j] - a[i, j] * a[j, i] for i, j in ((0, 1), (0, 2), (1, 2)))
    found = float(np.trace(a)), float(minors), float(np.linalg.det(a))
    closed = closed_invariants(alpha, frequency, zeta)
    return max(abs(x - y) / max(1.0, abs(y)) for x, y in zip(found, closed, strict=True))
