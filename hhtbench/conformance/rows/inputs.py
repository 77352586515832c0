"""Rows I1 to I8: initial data and inputs."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.conformance.rows.judging import Cases, apart, ends, refuses, row, same, within
from hhtbench.conformance.scenes.rod import Q0, UNCALLED, V0, Rod, plane, problem
from hhtbench.conformance.subject import Subject

OFF = hb.Status.inconsistent_initial
SHORT = (0.0, 0.2)  # [s]
STARTS = {  # with the level that is off
    "q0 by 0.1 %": (Q0 * 1.001, V0, "g[0]"),
    "q0 by 10 %": (Q0 * 1.1, V0, "g[0]"),
    "v0 not tangent": (Q0, V0 + 0.25 * Q0, "g_q v"),
}


@row("I1", "q0 off by 1e-3, by 10 %; v0 not tangent", "inconsistent_initial with the level; calc_initcond corrects")
def off_the_constraints(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row I1: q0 off by 1e-3, by 10 %; v0 not tangent.

    Both levels after the correction at most 1e-12.
    """
    for case, (q0, v0, level) in STARTS.items():
        yield case, ends(subject.ask(Rod(), SHORT, q0=q0, v0=v0, **request), OFF, words=(level,))
        found = subject.ask(Rod(), SHORT, q0=q0, v0=v0, **request, calc_initcond=True)
        yield f"{case}, corrected", ends(found, hb.Status.success, words=("moved q0 by",))
        q, v = found.q[0], found.v[0]
        yield f"{case}, levels", within(max(abs(q @ q - 1) / 2, abs(q @ v)), 1e-12, "levels after the correction")


@row("I2", "q0 from which no position meets the constraint", "inconsistent_initial in less than a second", seconds=1.0)
def no_root(subject: Subject) -> Cases:
    """Yield the cases of row I2: a constraint without real roots, from starts at four distances."""
    system = hb.NumpySystem(force=lambda t, q, v: np.zeros(2), constraint=lambda t, q: np.array([q @ q + 1.0]))
    for size in (1e-8, 1.0, 20.0, 1e12):
        yield f"{size:g}", ends(subject.ask(system, q0=size * Q0, rtol=1e-4, calc_initcond=True), OFF)


@row("I3", "multipliers guessed wrong by 100, or absent", "y and z change by at most 1e-8")
def wrong_guess(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row I3: wrong guesses of the multipliers, which at most start an iteration."""
    given = problem(Rod(), (0.0, 0.5))
    right = subject.ask(given, **request)
    for guess in (1e2, -1e4, 0.0):
        found = subject.ask(replace(given, lam_guess=np.array([guess])), **request)
        yield f"{guess:g}", within(apart(found, right), 1e-8, "moved by")


NO_NUMBERS: dict[str, Any] = {
    "nan": [np.nan, 0.0],
    "inf": [0.0, np.inf],
    "None": None,
    "text": "ab",
    "complex": [1j, 0.0],
    "masked": np.ma.masked_array([1.0, 2.0], [True, False]),
    "object": np.array([object(), 1.0]),
    "ragged": [[1.0], [1.0, 2.0]],
    "bool": [True, False],
    "None inside": [None, 1.0],
}
SHAPES = {str(shape): np.ones(shape) for shape in ((1, 2), (2, 1), (3,), (1,), ())}


def _start_refused(subject: Subject, values: dict[str, Any]) -> Cases:
    """Yield cases with wrong q0 or v0, which must be refused before a function of the system is called."""
    for case, value in values.items():
        for name in ("q0", "v0"):
            given = {"q0": Q0, "v0": V0, name: value}
            if subject.is_hht:
                call = partial(subject.hht(UNCALLED).solve, SHORT, *given.values(), steps=2)
            else:
                call = partial(subject.ask, UNCALLED, **given, rtol=1e-4)
            yield f"{name} {case}", refuses(call, "q0", "v0")


@row("I4", "NaN, inf, None, text, complex, masked, object, ragged q0 and v0", "refused by name before the first call")
def no_numbers(subject: Subject) -> Cases:
    """Yield the cases of row I4: q0 or v0 that are no real numbers; the system's functions raise when they are called."""
    return _start_refused(subject, NO_NUMBERS)


@row("I6", "q0, v0 of shape (1, n), (n, 1), n + 1, n - 1, ()", "refused with both shapes")
def shapes(subject: Subject) -> Cases:
    """Yield the cases of row I6: q0 or v0 of wrong shapes; the system's functions raise when they are called."""
    return _start_refused(subject, SHAPES)


def _kinds() -> dict[str, Any]:
    """Return the start of the rod as other kinds of arrays."""
    spaced, frozen = np.zeros(4), np.array(Q0)
    spaced[::2] = Q0
    frozen.setflags(write=False)
    kinds = {"list": list(Q0), "tuple": tuple(Q0), "jax": jnp.asarray(Q0), "strided": spaced[::2], "read-only": frozen}
    return {**kinds, "fortran": np.asfortranarray(np.stack([Q0, Q0]))[0]}


@row("I5", "integers, lists, float32, Fortran order, strided, read-only, JAX", "the bits of a float64 copy; input unchanged")
def kinds(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row I5: q0 as integers, list, float32, strided, read-only or JAX array."""
    right = subject.ask(Rod(), SHORT, **request)
    for case, q0 in _kinds().items():
        found = subject.ask(Rod(), SHORT, q0=q0, **request)
        yield case, same(found, right) or ("" if np.array_equal(np.asarray(q0), Q0) else "the input has changed")
    single = np.array([0.1, 0.0], dtype=np.float32)
    one = subject.ask(Rod(), SHORT, q0=[0, -1], v0=single, **request)
    other = subject.ask(Rod(), SHORT, q0=np.array([0.0, -1.0]), v0=single.astype(float), **request)
    yield "integers, float32", same(one, other)


@row("I7", "m = 0; m = n; m > n; n = 0", "result; refused where contradictory or empty")
def counts(subject: Subject) -> Cases:
    """Yield the cases of row I7: m = 0; m = n; m > n; n = 0.

    As many rows as coordinates hold the system still; a third that follows from two is left out.
    """

    def third(off: float) -> Any:
        return lambda t, q: np.array([q[0], q[1], q[0] + q[1] - off])

    cases: dict[str, tuple[Any, list[float], hb.Status]] = {
        "m = 0": (None, [0.3, 0.4], hb.Status.success),
        "m = n": (lambda t, q: q - np.array([0.3, 0.4]), [0.3, 0.4], hb.Status.success),
        "m > n": (third(0.0), [0.0, 0.0], hb.Status.success),
        "m > n, contradictory": (third(1.0), [0.0, 0.0], OFF),
    }
    for case, (constraint, q0, status) in cases.items():
        system = hb.NumpySystem(force=lambda t, q, v: np.array([3.0, -9.81]), constraint=constraint)
        yield case, ends(subject.ask(system, q0=q0, v0=[0.0, 0.0], rtol=1e-4), status)
    yield "n = 0", refuses(lambda: problem(plane(), q0=[], v0=[]), "q0")


WRONG_SIZES: dict[str, Any] = {
    "force": lambda t, q, v: np.zeros(3),
    "mass_matrix": lambda t, q: np.eye(3),
    "constraint_jacobian": lambda t, q: np.zeros((2, 2)),
    "force_jacobians": lambda t, q, v: (np.zeros((2, 3)), np.zeros((2, 2))),
    "constraint": lambda t, q: (q @ q - 1.0) / 2,
}


@row("I8", "sizes of M, f, g, G, F_q that disagree", "refused with the function and both shapes")
def sizes(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row I8: sizes of M, f, g, G, F_q that disagree, refused at the first call."""
    for name, function in WRONG_SIZES.items():
        yield name, refuses(partial(subject.ask, plane(**{name: function}), **request), name)
