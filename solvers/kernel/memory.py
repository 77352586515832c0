"""The memory of the loops: a float64 and an int64 array, and a table of the sections in them.

Each line below that calls :func:`floats` or :func:`integers` adds a section with its size; order, offsets and views
follow from it.  Two arrays, since compiling loops that pass tuples of fifty arrays takes five times as long, and counting
references to them takes longer than the linear algebra of small systems.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from hhtbench.lowering.compile.loops import FloatArray, IntArray

HIGHEST = 5  #: number of earlier steps whose unknowns are kept; a guess has at most one degree less
GIVEN = ("h", "t1", "of_a", "of_f", "from_end")  #: the step; a0 by the weights of a - f, of f and of a1
HEAD = ("t", "last", "size_q", "size_v", "known", "factor")  #: numbers of the state, of which t matters to the equations
#: memory of step control
CONTROL_NUMBERS = ("h_next", "last", "error", "has_reaction_k", "last_but_one", "bound")


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """The numbers that determine the sizes of all sections."""

    n: int  #: coordinates
    m: int  #: position constraints
    p: int  #: velocity constraints
    size: int  #: unknowns of a step
    inverse_mass: int  #: n*n where the mass varies, else 0
    applied: int = 0  #: multipliers whose reaction is an applied force, (H55)
    early: int = 0  #: numbers of the residual computed once per step, before the iteration
    early_matrix: int = 0
    computed: int = 0  #: numbers that the matrix function returns
    fresh: int = 0  #: numbers that the matrix function of a small system returns
    matrix: int = 0  #: entries of Newton's matrix
    maps: int = 0  #: entries of dq1/dx over dv1/dx
    storage: int = 0  #: numbers of one factorisation
    couplings: int = 0
    inverse: int = 0  #: size*size where the inverse is kept
    sections: dict[str, Any] = field(default_factory=dict)  #: contents of the integer sections of the linear algebra
    events: int = 0
    samples: int = 0  #: samples of all event functions in a step
    level: int = 0  #: unknowns of the acceleration level, where that is machine code

    @property
    def given(self) -> int:
        """Length of the vector of a step and the state before it."""
        return len(GIVEN) + len(HEAD) + 5 * self.n + self.m + self.p + 3 * self.applied + self.inverse_mass


_floats: list[Callable[[Sizes], int]] = []
_integers: list[Callable[[Sizes], int]] = []
_contents: dict[int, str] = {}


def floats(size: Callable[[Sizes], int]) -> int:
    """Add a section of floats; returns its number."""
    _floats.append(size)
    return len(_floats) - 1


def pairs(size: Callable[[Sizes], int]) -> int:
    """Add a section of floats for each of the two factorisations; returns the number of the first."""
    return [floats(size), floats(size)][0]


def integers(size: Callable[[Sizes], int]) -> int:
    """Add a section of integers; returns its number."""
    _integers.append(size)
    return len(_integers) - 1


def given_integers(name: str) -> int:
    """Add a section of integers whose content the linear algebra supplies by ``name``; returns its number."""
    _contents[len(_integers)] = name
    return integers(lambda s: len(s.sections.get(name, ())))


COUNTS = (
    "newton_iterations", "residual_evaluations", "jacobian_evaluations", "factorisations", "linear_solves",
    "steps_rejected_error", "event_evaluations", "steps_rejected_newton", "nonfinite_evaluations",
    "steps_accepted",
)  # fmt: skip
NEWTON, RESIDUALS, JACOBIANS, FACTORISATIONS, SOLVES, REJECTED, LOOKS, RESTARTS, NONFINITES, ACCEPTED = range(len(COUNTS))

NEWTON_CONSTANTS = (
    "tolerance", "margin", "stagnation", "stalled", "other_step", "refresh_rate", "worst_rate", "matrix_cost", "remaining",
    "stiff",
)  # fmt: skip

# The step (GIVEN of solvers.hht.equations.known), then the state: `start_of` takes them as one vector.
STEP = floats(lambda s: len(GIVEN))
NUMBER = floats(lambda s: len(HEAD))
Q = floats(lambda s: s.n)
V = floats(lambda s: s.n)
A = floats(lambda s: s.n)
F = floats(lambda s: s.n)
LAM = floats(lambda s: s.m)
MU = floats(lambda s: s.p)
VDOT = floats(lambda s: s.n)
LAM_BEFORE = floats(lambda s: s.applied)  # multipliers in the last state's f, in this f, and in f at the end, (H55)
LAM_APPLIED = floats(lambda s: s.applied)
LAM_AHEAD = floats(lambda s: s.applied)
INVERSE_MASS = floats(lambda s: s.inverse_mass)
X_LAST = floats(lambda s: s.size)
X_EARLIER = floats(lambda s: HIGHEST * s.size)
H_EARLIER = floats(lambda s: HIGHEST)  # signed lengths of these steps [s]
T, H, SIZE_Q, SIZE_V, KNOWN, FACTOR = range(6)  # in NUMBER; H = 0: no step yet; FACTOR: which of two it uses, or -1

# What error control remembers: h_next, the last two steps, error (-1: none), whether R_k is known, a bound on steps since
# Newton's iteration failed; f + r before and after the last step; R_k; q before the last two
# steps and before the last.
CONTROL = floats(lambda s: len(CONTROL_NUMBERS))
BEFORE = floats(lambda s: s.n)
ACCELERATION = floats(lambda s: s.n)
REACTION_K = floats(lambda s: s.n)
Q_FIRST = floats(lambda s: s.n)
Q_BEFORE = floats(lambda s: s.n)
H_NEXT, LAST, LAST_ERROR, HAS_REACTION_K, LAST_BUT_ONE, BOUND = range(6)  # in CONTROL

# Of the two stored factorisations: numbers of each, and the arguments of the matrix.  The state ends here.
RECORD = pairs(lambda s: 7)
MADE_AT = pairs(lambda s: 2 * s.size + 1 + s.given)

# An attempt at a step: its numbers; iterate, residual, result of the matrix function, all entries; its end.
ATTEMPT = floats(lambda s: 12)
X = floats(lambda s: s.size)
PREVIOUS = floats(lambda s: 1 + s.size)  # 1 and the iterate before; or 0: this step has none
RESIDUAL = floats(lambda s: s.size)
COMPUTED = floats(lambda s: s.computed)
VALUES = floats(lambda s: s.size + s.matrix + s.maps)
SCALED = floats(lambda s: s.matrix)  # entries of the matrix whose rows are scaled
RIGHT = floats(lambda s: s.size)
WORK = floats(lambda s: s.size)
INCREMENT = floats(lambda s: 2 * s.size + 2)  # for small systems followed by its sizes and the residual
LEAP = floats(lambda s: s.n)  # displacements tested by (H58), then those that Python finds to switch branches
END = floats(lambda s: (7 if s.m else 5) * s.n + s.m + s.p)  # q, v, a, f, lam, mu, v', with constraints R0, R1
END_INVERSE_MASS = floats(lambda s: s.inverse_mass)
EARLY = floats(lambda s: s.early)
EARLY_MATRIX = floats(lambda s: s.early_matrix)
FRESH = floats(lambda s: s.fresh)
TYPICAL = floats(lambda s: 2)  # sizes of q and of v; below: reciprocals used by Newton's iteration
RECIPROCAL = floats(lambda s: 2)
NOISE = floats(lambda s: 2)  # roundoff of an increment in q1 and v1, measured for one matrix in one step; -1: not yet
BASE_X = floats(lambda s: s.size)  # iterate and whole increment of a damped iteration
FULL = floats(lambda s: 2 * s.size + 2)
UNDISTURBED = floats(lambda s: 4 * s.n)  # q, v, a, f while roundoff is measured
# In ATTEMPT; LEAPS: 1 + the coordinate that leapt, or 0; MADE: matrices of this attempt.
H_TRIED, T_END, SLOT, CONTRACTION, ERROR_SIZE, NEXT_H, FIRST_H, FIRST_ERROR = range(8)
ROOT_TOLERANCE, COST, LEAPS, MADE = range(8, 12)

# Its error: raw errors, a point (t, q, v) for evaluations, the constraint levels there.
RAW = floats(lambda s: 3 * s.n)
MISSED = floats(lambda s: s.n)  # error of the position row, (H59); below: response of the force rows
ANSWER = floats(lambda s: s.n)
PLACE = floats(lambda s: 1 + 2 * s.n)
LEVELS = floats(lambda s: 2 * s.m + s.p)
ERROR = floats(lambda s: 2 * s.n)
WEIGHTS = floats(lambda s: 2 * s.n)
RTOL = floats(lambda s: 2 * s.n)
ATOL = floats(lambda s: 2 * s.n)
SOLUTION = floats(lambda s: s.size)  # unknowns that solve for RIGHT; below: their changes of q1 and v1
CHANGE = floats(lambda s: 2 * s.n)

# Two factorisations: row scales, factors, couplings, maps to q1 and v1, inverse.
ROW_SCALES = pairs(lambda s: s.size)
STORAGE = pairs(lambda s: s.storage)
COUPLINGS = pairs(lambda s: s.couplings)
MAPS = pairs(lambda s: s.maps)
INVERSE = pairs(lambda s: s.inverse)
MADE_H, RATE, USES, INVERTED, KEPT_COST, LEAST_PIVOT, RANK = range(7)  # in RECORD

CONSTANTS = floats(lambda s: 4 + len(NEWTON_CONSTANTS))
EVENT = floats(lambda s: 1)
EVENT_VALUES = floats(lambda s: 2 * s.events)  # at the last step's end, then the roundoff of those at a zero
SAMPLE_TIMES = floats(lambda s: s.samples)
SAMPLE_VALUES = floats(lambda s: s.samples)
LU_ASKED = floats(lambda s: 1)  # index of a factorisation in Python; below: [success, least pivot, rank]
FACTOR_RESULT = floats(lambda s: 3)
SOLVED = floats(lambda s: s.size)
# The acceleration level: [success, lam, mu, v']; in machine code [v', lam, mu], residual and matrix, column and row scales.
ACCELERATION_LEVEL = floats(lambda s: 1 + s.n + s.m + s.p)
LEVEL_X = floats(lambda s: s.level)
LEVEL_TERMS = floats(lambda s: s.level * (1 + s.level))
LEVEL_SCALE = floats(lambda s: s.level)
LEVEL_ROW_SCALE = floats(lambda s: s.level)
FORCE = floats(lambda s: s.n + s.inverse_mass)  # f, M^-1
START_LEVELS = floats(lambda s: (s.m * (3 + s.n) + s.p * (2 + s.n)) * (s.level > 0))  # constraint levels with Jacobians
ROW_SIZES = floats(lambda s: s.m + s.p)  # sizes of the rows of [g_q; k_v], by which violations are measured
START_CHECKS = floats(lambda s: 4)
START_BOUNDS = floats(lambda s: 4)  # bounds on these of a good start
VIOLATION, SPREAD, ASYMMETRY, CONDITION = range(4)  # in START_CHECKS; SPREAD: of pivots, largest over least

ALPHA, BETA, GAMMA = range(3)  # in CONSTANTS
TOLERANCE, MARGIN, STAGNATION, STALLED, OTHER_STEP, REFRESH_RATE, WORST_RATE, MATRIX_COST = range(3, 11)
REMAINING, STIFF, LEAST_OFF = range(11, 14)

# Positions of the entries of the matrix and of the maps below it, see solvers.kernel.linear.analysis.
TARGETS, INSIDE, PLACES, OUTSIDE, STARTS, COUPLED, ROWS, COLUMNS, BLOCKS, MAP_STARTS, MAP_COLUMNS = map(
    given_integers,
    (
        "targets",
        "inside",
        "places",
        "outside",
        "starts",
        "coupled",
        "rows",
        "columns",
        "blocks",
        "map_starts",
        "map_columns",
    ),
)
ROW_STARTS = given_integers("row_starts")
ENTRY_ROWS, ENTRY_COLUMNS = map(given_integers, ("entry_rows", "entry_columns"))  # places of the entries, or nothing
PIVOTS = integers(lambda s: s.size)  # of the first factorisation; below: of the second
integers(lambda s: s.size)
LAPACK = integers(lambda s: 4)  # arguments by address: size, one, "N", info
ONE, TRANSPOSED, INFO = 1, 2, 3  # in LAPACK, after the size; whether: "N" or "T"
LEVEL_PIVOTS = integers(lambda s: s.level)
LEVEL_LAPACK = integers(lambda s: 4)
EVENT_CODE = integers(lambda s: 2 * s.events)
COUNTED = integers(lambda s: len(COUNTS))  # work since Python read them last
DIRECTIONS = integers(lambda s: s.events)
SAMPLES = integers(lambda s: s.events)

# The header: starts and lengths of all sections, then single numbers.
FIRST = 2 * (len(_floats) + len(_integers))
N, M, P, SIZE, O_R0, O_R1, O_LAM0, O_LAM1, O_RK, O_MU = range(FIRST, FIRST + 10)  # O_: offsets of unknowns, -1: absent
VARIABLE, OWN, RESCALE_A, TRAPEZOIDAL, MAX_ITERATIONS = range(FIRST + 10, FIRST + 15)
EVALUATIONS, BASE, INTEGER_BASE, KIND, ENDED, FALLBACK, CALLS_PYTHON, NOISY = range(FIRST + 15, FIRST + 23)
DGETRF, DGETRS, STOPS_EARLY, CONTROLLED, WATCHING, LINEAR, STIFF_FORCES = range(FIRST + 23, FIRST + 30)
FUNCTIONS = (
    "residual", "matrix", "end", "inverse_mass", "raw", "levels", "early", "early_matrix", "acceleration",
    "factor", "solve", "force", "kkt", "start_levels", "constraints", "inertia", "leap", "answer",
)  # fmt: skip
CODE = FIRST + 30
C_RESIDUAL, C_MATRIX, C_END, C_INVERSE_MASS, C_RAW, C_LEVELS, C_EARLY, C_EARLY_MATRIX = range(CODE, CODE + 16, 2)
C_ACCELERATION, C_FACTOR, C_SOLVE, C_FORCE, C_KKT, C_START_LEVELS, C_CONSTRAINTS = range(CODE + 16, CODE + 30, 2)
C_INERTIA, C_LEAP, C_ANSWER = range(CODE + 30, CODE + 36, 2)
HEADER = CODE + 2 * len(FUNCTIONS)

KIND_INVERSE, KIND_BAND, KIND_DENSE, KIND_CALLBACK = range(4)  # of the linear algebra

# Ending codes of an attempt, and of a call of the loops.
CONVERGED, DIVERGED, NONFINITE, SINGULAR, SPENT, FALL_BACK = range(6)
NO_ADVANCE, TOO_LARGE, ROUNDOFF_REACHED, EVENT_FOUND, EVENT_NONFINITE = range(6, 11)


class Memory(NamedTuple):
    """All numbers of the loops: floats and integers."""

    w: FloatArray  #: sections of floats
    i: IntArray  #: starts and lengths of the sections, header, sections


def allocate(sizes: Sizes) -> Memory:
    """Allocate the memory for ``sizes``: zero except for the header and the integers of the linear algebra."""
    lengths = [size(sizes) for size in _floats]
    counts = [size(sizes) for size in _integers]
    starts = np.cumsum([0, *lengths])
    places = HEADER + np.cumsum([0, *counts])
    z = Memory(np.zeros(int(starts[-1])), np.zeros(int(places[-1]), dtype=np.int64))
    table = [pair for pairs in (zip(starts, lengths, strict=False), zip(places, counts, strict=False)) for pair in pairs]
    z.i[:FIRST] = np.ravel(table)
    z.i[BASE], z.i[INTEGER_BASE] = z.w.ctypes.data, z.i.ctypes.data
    z.i[N : N + 4] = sizes.n, sizes.m, sizes.p, sizes.size
    z.i[VARIABLE] = sizes.inverse_mass > 0
    for section, name in _contents.items():
        integer_view(z, section)[:] = sizes.sections.get(name, ())
    return z


def copied(z: Memory) -> Memory:
    """A copy of the memory, with the base addresses updated."""
    other = Memory(z.w.copy(), z.i.copy())
    other.i[BASE], other.i[INTEGER_BASE] = other.w.ctypes.data, other.i.ctypes.data
    return other


def view(z: Memory, section: int) -> Any:
    """A section of floats, as a writable view."""
    return z.w[z.i[2 * section] : z.i[2 * section] + z.i[2 * section + 1]]


def integer_view(z: Memory, section: int) -> Any:
    """A section of integers, as a writable view."""
    at = 2 * (len(_floats) + section)
    return z.i[z.i[at] : z.i[at] + z.i[at + 1]]


INTEGER = len(_floats)  #: the first of the integer sections in the header
