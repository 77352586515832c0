"""What the compiled loops work with: one float64 array, one int64 array, and the names of the sections in them.

Few and plain arguments: compiling loops that pass tuples of fifty arrays takes five times as long as the loops themselves,
and counting references to those arrays three times as long as small systems' linear algebra.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from hhtbench.lowering.compile.loops import FloatArray, IntArray

CONVERGED, DIVERGED, NONFINITE, SINGULAR, SPENT, ELSEWHERE = range(6)  # how an attempt at a step ended
COUNTS = (
    "newton_iterations",
    "residual_evaluations",
    "jacobian_evaluations",
    "factorisations",
    "linear_solves",
    "steps_rejected_error",
    "event_evaluations",
    "steps_rejected_newton",
)
NEWTON, RESIDUALS, JACOBIANS, FACTORISATIONS, SOLVES, REJECTED, LOOKS, RESTARTS = range(len(COUNTS))

FLOATS = (
    "step", "number", "q", "v", "a", "f", "lam", "mu", "vdot", "inverse", "x_last", "x_earlier",
    "memory", "before", "acceleration", "rolling",
    "x", "residual", "computed", "values", "right", "work", "increment", "end", "end_inverse",
    "raw_given", "raw", "place", "levels", "error", "weights", "rtol", "atol",
    "storage", "couplings", "maps", "factor_h", "rate", "uses", "built", "inverse_matrix",
    "constants", "event", "event_values", "event_ends", "early", "early_matrix", "fresh",
    "rights", "works", "answers", "changes", "base_x", "full", "undisturbed",
)  # fmt: skip
# What packed_known takes: the step, see GIVEN in solvers.hht.weights, and behind it the state.
STEP = 0
# The state: t, h of the last step (0: none), sizes of q and v, how many x are known, slot of the factors (-1: none) ...
NUMBER, Q, V, A, F, LAM, MU, VDOT, INVERSE, X_LAST, X_EARLIER = range(1, 12)
# ... and its memory: h_next, last, error (-1: none), whether R_k is known; f + r before and after the last step; R_k.
MEMORY, BEFORE, ACCELERATION, ROLLING = range(12, 16)
# An attempt: the iterate, its residual, what the matrix function computes, all entries; END: the state after it, R0, R1 ...
X, RESIDUAL, COMPUTED, VALUES, RIGHT, WORK, INCREMENT, END, END_INVERSE = range(16, 25)
# ... and its error: raw_errors' input and output, a place t, q, v to look at, the constraint levels there.
RAW_GIVEN, RAW, PLACE, LEVELS, ERROR, WEIGHTS, RTOL, ATOL = range(25, 33)
# Two factorisations, one after the other; solves with each, whether its inverse is made, and that, column by column.
STORAGE, COUPLINGS, MAPS, FACTOR_H, RATE, USES, BUILT, INVERSE_MATRIX = range(33, 41)
CONSTANTS, EVENT, EVENT_VALUES, EVENT_ENDS, EARLY, EARLY_MATRIX = range(41, 47)  # EARLY: what is known before the iterate
FRESH = 47  # of a small system: what fresh_correction returns
RIGHTS, WORKS, ANSWERS, CHANGES = range(48, 52)  # two right-hand sides at once, entry beside entry
BASE_X, FULL = range(52, 54)  # of damped iterations: the iterate and the whole increment
UNDISTURBED = 54  # q, v, a, f while roundoff is measured

T, H, SIZE_Q, SIZE_V, KNOWN, FACTOR = range(6)  # in NUMBER
H_NEXT, LAST, LAST_ERROR, HAS_ROLLING = range(4)  # in MEMORY
NEWTON_CONSTANTS = (
    "tolerance", "margin", "stagnation", "other_step", "refresh_rate", "worst_rate", "least_rate", "blinded",
    "stalled", "second", "noise_margin",
)  # fmt: skip
ALPHA, BETA, GAMMA = range(3)  # in CONSTANTS
TOLERANCE, MARGIN, STAGNATION, OTHER_STEP, REFRESH_RATE, WORST_RATE, LEAST_RATE, BLINDED = range(3, 11)
STALLED, SECOND, NOISE_MARGIN = range(11, 14)

INTEGERS = (
    "header",
    "slots", "inside", "places", "outside", "starts", "coupled", "rows", "columns", "blocks", "map_starts", "map_columns",
    "pivots", "event_code", "event_directions", "event_samples",
)  # fmt: skip
# Where the entries of the matrix and of the maps below it go, see Entries.
SLOTS, INSIDE, PLACES, OUTSIDE, STARTS, COUPLED, ROWS, COLUMNS, BLOCKS, MAP_STARTS, MAP_COLUMNS = range(1, 12)
PIVOTS, EVENT_CODE, DIRECTIONS, SAMPLES = range(12, 16)  # pivots of both factorisations

# The header: starts and lengths of all sections, sizes, offsets of unknowns (-1: absent), addresses of code and parameters.
FIRST = 2 * (len(FLOATS) + len(INTEGERS))
HEADERS = (
    "n", "m", "p", "size", "R1", "lam0", "lam1", "Rk", "mu",
    "variable", "own", "rescale_a", "trapezoidal", "max_iterations", "evaluations", "base", "small",
    "max_damped", "max_halvings",
)  # fmt: skip
N, M, P, SIZE, O_R1, O_LAM0, O_LAM1, O_RK, O_MU = range(FIRST, FIRST + 9)
VARIABLE, OWN, RESCALE_A, TRAPEZOIDAL, MAX_ITERATIONS, EVALUATIONS, BASE, SMALL = range(FIRST + 9, FIRST + 17)
MAX_DAMPED, MAX_HALVINGS = FIRST + 17, FIRST + 18
FUNCTIONS = ("residual", "matrix", "end", "inverse", "raw", "levels", "early", "early_matrix")
CODE = FIRST + 19
C_RESIDUAL, C_MATRIX, C_END, C_INVERSE, C_RAW, C_LEVELS, C_EARLY, C_EARLY_MATRIX = range(CODE, CODE + 16, 2)


class Memory(NamedTuple):
    """Everything: floating-point numbers and integers."""

    w: FloatArray  #:
    i: IntArray  #: starts and lengths of the sections, header, sections


class Control(NamedTuple):
    """Constants of step control, named as in :class:`~solvers.hht.control.ControlOptions`."""

    controlled: bool
    watching: bool  #: whether a step with an event is left to the host engine
    stop: float  #: [s]
    min_step: float
    max_step: float
    target: float
    integral: float
    proportional: float
    growth: float
    shrink: float
    keep: tuple[float, float]
    least: float
    spacings: float


def memory(floats: Mapping[str, Any], integers: Mapping[str, Any]) -> Memory:
    """One array of each kind with copies of the contents of all sections."""
    parts = [np.ravel(np.asarray(floats[name], dtype=np.float64)) for name in FLOATS]
    indices = [np.ravel(np.asarray(integers[name], dtype=np.int64)) for name in INTEGERS]
    table = np.array(_table(parts, 0) + _table(indices, FIRST), dtype=np.int64)
    z = Memory(np.concatenate(parts), np.concatenate([table, *indices]))
    z.i[BASE] = z.w.ctypes.data
    return z


def floats(z: Memory, name: int) -> Any:
    """A section of floats, for reading and writing."""
    return z.w[z.i[2 * name] : z.i[2 * name] + z.i[2 * name + 1]]


def integers(z: Memory, name: int) -> Any:
    """A section of integers, for reading and writing."""
    at = 2 * (len(FLOATS) + name)
    return z.i[z.i[at] : z.i[at] + z.i[at + 1]]


def _table(parts: list[Any], start: int) -> list[int]:
    table = []
    for part in parts:
        table += [start, part.size]
        start += part.size
    return table
