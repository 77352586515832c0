"""Steps of the method written by hand in C, compiled here, beside the library's."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hhtbench.protocol import Problem
from problems import andrews, jay_negrut_pendulum

SOURCES = Path(__file__).parents[1]  # where the C files lie
FLAGS = ("-O3", "-march=native", "-std=c11", "-shared", "-fPIC")
SIZES = {"pendulum": 2, "andrews": 6}  # multipliers
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
    source: str  #: file and prefix of the C function
    limit: float = 1.0  #: our time over C's
    rtol: float | None = None  #: ours under error control, and C's steps of the mean length, as many


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
            h=1e-3,
            steps=int(4000 * share),
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
            name="pendulum of the paper, 40 s, rtol 1e-6",
            problem=jay_negrut_pendulum.problem(t_end=40.0 * share),
            h=1e-3,
            steps=int(40_000 * share),
            source="pendulum",
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
    for name in ("pendulum", "andrews"):
        library = folder / f"{name}.so"
        command = [cc, *FLAGS, str(SOURCES / f"{name}_step.c"), "-o", str(library), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"the C compiler failed on {name}_step.c: {done.stderr.strip()[:300]}")
        function = getattr(ctypes.CDLL(str(library)), f"{name}_steps")
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
    leading = []
    if case.source == "pendulum":
        values = np.array([float(getattr(problem.system, name)) for name in PENDULUM])
        leading = [values.ctypes.data_as(ctypes.c_void_p)]
    iterations = function(*leading, ctypes.c_double(case.h), ctypes.c_double(ALPHA), ctypes.c_long(count), *arrays)
    if iterations < 0:
        raise RuntimeError(f"{case.name}: Newton's iteration of the C version failed")
    return End(q, v, iterations)


def difference(one: End, other: End) -> float:
    """Largest difference of q and of v, over the largest of each."""
    return max(float(np.abs(a - b).max() / np.abs(b).max()) for a, b in ((one.q, other.q), (one.v, other.v)))
