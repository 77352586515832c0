"""Initial data and inputs (rows I1 to I8)."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.studies.acceptance.asked import Asked
from hhtbench.studies.acceptance.rows import Finding, bounded, every, row
from hhtbench.studies.acceptance.scenes import PLAIN, Q0, V0, Rod, apart, ends, never, plane, problem, refuses, same

OFF = hb.Status.inconsistent_initial
STARTS = {"q0 by 0.1 %": (Q0 * 1.001, V0), "q0 by 10 %": (Q0 * 1.1, V0), "v0 not tangent": (Q0, V0 + 0.25 * Q0)}


@row(
    "I1",
    "q0 off by 1e-3, by 10 %; v0 not tangent",
    "inconsistent_initial with the residual; calc_initcond corrects and says so",
)
def off_the_constraints(asked: Asked) -> Finding:
    """Both levels after the correction at most 1e-12."""
    faults, levels = {}, 0.0
    for case, (q0, v0) in STARTS.items():
        given = problem(Rod(), q0, v0, (0.0, 0.2))
        for way, request in asked.ways().items():
            faults[f"{case} {way}"] = ends(asked.solve(given, **request), OFF, words=("[0]",))
            found = asked.solve(given, **request, calc_initcond=True)
            faults[f"{case} {way}, corrected"] = ends(found, hb.Status.success, words=("moved q0 by",))
            levels = max(levels, abs(found.q[0] @ found.q[0] - 1) / 2, abs(found.q[0] @ found.v[0]))
            faults["levels"] = "" if levels <= 1e-12 else f"levels {levels:.1e}"
    return every(faults, f"levels {levels:.1e} after the correction")


@row("I2", "q0 from which no position meets the constraint", "inconsistent_initial in less than a second")
def no_root(asked: Asked) -> Finding:
    """Wall time of the worst."""
    faults, slowest = {}, 0.0
    for size in (1e-8, 1.0, 20.0, 1e12):
        system = hb.NumpySystem(force=lambda t, q, v: np.zeros(2), constraint=lambda t, q: np.array([q @ q + 1.0]))
        began = time.perf_counter()
        found = asked.solve(problem(system, size * Q0, V0), rtol=1e-4, calc_initcond=True)
        slowest = max(slowest, time.perf_counter() - began)
        faults[f"{size:g}"] = ends(found, OFF)
    return every(faults, f"slowest {slowest:.2g} s", in_time=slowest < 1)


@row("I3", "multipliers guessed wrong by 100, or absent", "y and z change by at most 1e-8")
def wrong_guess(asked: Asked) -> Finding:
    """The reaction is linear: the guess is a start of an iteration at most."""
    given = problem(Rod(), Q0, V0, (0.0, 0.5))
    worst = 0.0
    for request in asked.ways().values():
        right = asked.solve(given, **request)
        for guess in ([1e2], [-1e4], [0.0]):
            worst = max(worst, apart(asked.solve(replace(given, lam_guess=np.array(guess)), **request), right))
    return bounded(worst, 1e-8, "moved by")


BAD: dict[str, Any] = {
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
SHAPES = ((1, 2), (2, 1), (3,), (1,), ())


def _start_refused(asked: Asked, values: dict[str, Any]) -> Finding:
    system, faults = hb.NumpySystem(force=never, constraint=never), {}
    for case, value in values.items():
        for name in ("q0", "v0"):
            given = {"q0": Q0, "v0": V0, name: value}

            def by_hand(given: Any = given) -> Any:
                return asked.hht(system).solve((0.0, 0.2), given["q0"], given["v0"], steps=2)

            def by_problem(given: Any = given) -> Any:
                return asked.solve(problem(system, given["q0"], given["v0"]), rtol=1e-4)

            faults[f"{name} {case}"] = refuses(by_hand if asked.is_hht else by_problem, "q0", "v0")
    return every(faults)


@row("I4", "NaN, inf, None, text, complex, masked, object, ragged q0 and v0", "refused by name before the first call")
def no_numbers(asked: Asked) -> Finding:
    """The system's functions raise when they are called."""
    return _start_refused(asked, BAD)


@row("I6", "q0, v0 of shape (1, n), (n, 1), n + 1, n - 1, ()", "refused with both shapes")
def shapes(asked: Asked) -> Finding:
    """As I4."""
    return _start_refused(asked, {str(shape): np.ones(shape) for shape in SHAPES})


@row(
    "I5",
    "whole numbers, lists, float32, Fortran order, strided, read-only, JAX",
    "the bits of a float64 copy; input unchanged",
)
def kinds(asked: Asked) -> Finding:
    """float32 means its own float64 value."""
    spaced, frozen = np.zeros(4), np.array(Q0)
    spaced[::2] = Q0
    frozen.setflags(write=False)
    column = np.asfortranarray(np.stack([Q0, Q0]))[0]
    given = {"list": list(Q0), "tuple": tuple(Q0), "jax": jnp.asarray(Q0), "strided": spaced[::2], "fortran": column}
    faults = {}
    for way, request in asked.ways().items():
        right = asked.solve(problem(Rod(), Q0, V0, (0.0, 0.2)), **request)
        for case, q0 in {**given, "read-only": frozen}.items():
            found = asked.solve(problem(Rod(), q0, V0, (0.0, 0.2)), **request)
            kept = np.array_equal(np.asarray(q0), Q0)
            faults[f"{case} {way}"] = "" if same(found, right) and kept else "other bits"
        down, single = np.array([0.0, -1.0]), np.array([0.1, 0.0], dtype=np.float32)
        one, other = (
            asked.solve(problem(Rod(), q, v, (0.0, 0.2)), **request)
            for q, v in (([0, -1], single), (down, single.astype(float)))
        )
        faults[f"whole numbers, float32 {way}"] = "" if same(one, other) else "other bits"
    return every(faults)


@row("I7", "m = 0; m = n; m > n; n = 0", "result; refused where contradictory or empty")
def counts(asked: Asked) -> Finding:
    """As many rows as coordinates hold the system still; a third that follows from two is left out."""
    rest = lambda t, q, v: np.array([3.0, -9.81])  # noqa: E731
    point = lambda t, q: q - np.array([0.3, 0.4])  # noqa: E731
    third = lambda off: lambda t, q: np.array([q[0], q[1], q[0] + q[1] - off])  # noqa: E731
    request: dict[str, Any] = {"rtol": 1e-4}
    cases = {
        "m = 0": (hb.NumpySystem(force=rest), [0.3, 0.4], hb.Status.success),
        "m = n": (hb.NumpySystem(force=rest, constraint=point), [0.3, 0.4], hb.Status.success),
        "m > n": (hb.NumpySystem(force=rest, constraint=third(0.0)), [0.0, 0.0], hb.Status.success),
        "m > n, contradictory": (hb.NumpySystem(force=rest, constraint=third(1.0)), [0.0, 0.0], OFF),
    }
    faults = {
        case: ends(asked.solve(problem(x, q0, [0.0, 0.0]), **request), status) for case, (x, q0, status) in cases.items()
    }
    return every(faults | {"n = 0": refuses(lambda: problem(PLAIN.problem.system, [], []), "q0")})


WRONG_SIZES: dict[str, Any] = {
    "force": lambda t, q, v: np.zeros(3),
    "mass_matrix": lambda t, q: np.eye(3),
    "constraint_jacobian": lambda t, q: np.zeros((2, 2)),
    "force_jacobians": lambda t, q, v: (np.zeros((2, 3)), np.zeros((2, 2))),
    "constraint": lambda t, q: (q @ q - 1.0) / 2,
}


@row("I8", "sizes of M, f, g, G, F_q that disagree", "refused with the function and both shapes")
def sizes(asked: Asked) -> Finding:
    """At the first call."""
    faults = {}
    for name, function in WRONG_SIZES.items():
        given = problem(plane(**{name: function}), Q0, V0)
        for way, request in asked.ways().items():
            faults[f"{name} {way}"] = refuses(partial(asked.solve, given, **request), name)
    return every(faults)
