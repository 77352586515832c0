"""Steps of the method written by hand in C, compiled here, beside the library's."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from hhtbench.protocol.problem import Problem
from problems import andrews, jay_negrut_pendulum
from solvers.hht import HHT

SOURCES = Path(__file__).parents[1]  # where the C files lie
FLAGS = ("-O3", "-march=native", "-std=c11", "-shared", "-fPIC")
FUNCTIONS = {  # file and function by source
    "pendulum": ("pendulum_step.c", "pendulum_steps"),
    "andrews": ("andrews_step.c", "andrews_steps"),
    "control": ("pendulum_control.c", "pendulum_controlled"),
}
SIZES = {"pendulum": 2, "andrews": 6}  # multipliers
FIRST = 5  # steps of the library after which C's error control goes on
ALPHA = -0.3  # of all baselines
PENDULUM = ("m", "L", "k", "c", "g")  # its parameters, in the order of the C structure
Vector = np.ndarray


@dataclass(frozen=True, kw_only=True)
class Case:
    """One scene with constant steps."""

    name: str
    problem: Problem
    h: float  #: [s]
    steps: int
    source: str  #: of ``FUNCTIONS``
    limit: float = 1.0  #: our time over C's
    rtol: float | None = None  #: under error control, with as large an absolute tolerance; h and steps count for nothing


@dataclass(frozen=True)
class End:
    """Where a run of steps ended."""

    q: Vector
    v: Vector
    iterations: int  #: of Newton, all steps together


def cases(share: float = 1.0) -> tuple[Case, ...]:
    """The scenes, with ``share`` of their steps."""
    undamped = int(100_000 * share)
    return (
        Case(
            name="pendulum of the paper, 4 s",
            problem=jay_negrut_pendulum.problem(t_end=4.0 * share),
            h=1e-4,  # so short that the start, which is subtracted, is a small part of the run
            steps=int(40_000 * share),
            source="pendulum",
        ),
        Case(
            name="the same undamped, 100 s",
            problem=jay_negrut_pendulum.problem(c=0.0, t_end=undamped * 1e-3),
            h=1e-3,
            steps=undamped,
            source="pendulum",
        ),
        Case(
            name="the paper's, 40 s, rtol 1e-6",
            problem=jay_negrut_pendulum.problem(t_end=40.0 * share),
            h=0.0,
            steps=0,
            source="control",
            rtol=1e-6,
        ),
        Case(
            name="andrews, 0.03 s",
            problem=andrews.problem(t_end=0.03 * share),
            h=0.03 / 12_000,
            steps=int(12_000 * share),
            source="andrews",
            limit=0.6,
        ),
    )


def compiler() -> str | None:
    """A C compiler, or None."""
    return shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


def build(folder: Path) -> dict[str, Any]:
    """The C functions by name of their source; compiled into ``folder``.

    Raises
    ------
    RuntimeError
        There is no compiler, or it failed; the text says which.
    """
    cc = compiler()
    if cc is None:
        raise RuntimeError("there is no C compiler (cc, gcc or clang)")
    found = {}
    for name, (file, called) in FUNCTIONS.items():
        library = folder / f"{name}.so"
        command = [cc, *FLAGS, str(SOURCES / file), "-o", str(library), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"the C compiler failed on {file}: {done.stderr.strip()[:300]}")
        function = getattr(ctypes.CDLL(str(library)), called)
        function.restype = ctypes.c_long
        found[name] = function
    return found


def take_steps(function: Any, case: Case, steps: int | None = None) -> End:
    """The C function's end after ``steps`` steps, all of the case by default."""
    problem = case.problem
    q, v = problem.q0.astype(np.float64), problem.v0.astype(np.float64)
    lam = np.zeros(SIZES[case.source]) if problem.lam_guess is None else np.array(problem.lam_guess, dtype=np.float64)
    count = case.steps if steps is None else steps
    arrays = [x.ctypes.data_as(ctypes.c_void_p) for x in (q, v, lam)]
    leading = [_parameters(problem)] if case.source == "pendulum" else []
    iterations = function(*leading, ctypes.c_double(case.h), ctypes.c_double(ALPHA), ctypes.c_long(count), *arrays)
    if iterations < 0:
        raise RuntimeError(f"{case.name}: Newton's iteration of the C version failed")
    return End(q, v, iterations)


class Memory(ctypes.Structure):
    """Between two steps under error control, as ``State`` in pendulum_control.c."""

    _fields_: ClassVar = [(name, ctypes.c_double) for name in ("t", "h", "h_next", "last", "error")] + [
        (name, ctypes.c_double * size)
        for name, size in (("q", 3), ("v", 3), ("a", 3), ("lam", 2), ("earlier", 3), ("acceleration", 3))
    ]


def after_first_steps(case: Case) -> Memory:
    """Where the library stands after its first steps under error control."""
    assert case.rtol is not None
    problem = case.problem
    hht = HHT(problem.system, alpha=ALPHA, b=0.0)
    hht.init_step(problem.t_span[0], problem.q0, problem.v0, rtol=case.rtol, atol=case.rtol, lam_guess=problem.lam_guess)
    for _ in range(FIRST):
        hht.step(tstop=problem.t_span[1])
    state, control = hht.state, hht.state.memory
    assert control is not None
    numbers = state.t, state.h, control.h_next, control.last, -1.0 if control.error is None else control.error
    arrays = state.q, state.v, state.a, state.lam, control.earlier, control.acceleration
    sizes = [kind for _, kind in Memory._fields_[len(numbers) :]]
    return Memory(*numbers, *(kind(*map(float, array)) for kind, array in zip(sizes, arrays, strict=True)))


@dataclass(frozen=True)
class Controlled:
    """A run under error control."""

    end: End
    accepted: int
    rejected: int


def take_controlled(function: Any, case: Case, start: Memory) -> Controlled:
    """The C function's end at the end of the case, from ``start``; what was before it is not counted."""
    state, counts, size = Memory.from_buffer_copy(start), (ctypes.c_long * 3)(), len(start.q)
    atol = (ctypes.c_double * (2 * size))(*[case.rtol] * (2 * size))
    stop, rtol = (ctypes.c_double(value) for value in (case.problem.t_span[1], case.rtol))
    if not function(_parameters(case.problem), ctypes.c_double(ALPHA), stop, rtol, atol, ctypes.byref(state), counts):
        raise RuntimeError(f"{case.name}: Newton's iteration of the C version failed")
    return Controlled(End(np.array(state.q), np.array(state.v), counts[2]), counts[0], counts[1])


def _parameters(problem: Problem) -> Any:
    """The pendulum's, as the C structure holds them."""
    return (ctypes.c_double * len(PENDULUM))(*(float(getattr(problem.system, name)) for name in PENDULUM))


def difference(one: End, other: End) -> float:
    """Largest difference of q and of v, over the largest of each."""
    return max(float(np.abs(a - b).max() / np.abs(b).max()) for a, b in ((one.q, other.q), (one.v, other.v)))
