"""The processes that hhtbench starts, its commands, workers and benchmarks: in each of them BLAS has one thread.

The matrices here are small.  A second thread gains nothing and waits for a core that another process has: on two cores,
one of them busy, a solve of 160 equations takes 6 to 15 ms in the mean instead of 0.3.  The number is set once per process
and never by a solve, since it belongs to all threads of the process.  XLA's own threads are left alone.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

from numpy.linalg import _umath_linalg
from scipy.linalg import _flapack

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
LINKED = (_umath_linalg, _flapack)  # with BLAS: NumPy and SciPy bring a copy each
OPENBLAS = (
    "scipy_openblas_{}_num_threads64_",
    "scipy_openblas_{}_num_threads",
    "openblas_{}_num_threads64_",
    "openblas_{}_num_threads",
)


def one_blas_thread() -> None:
    """Give BLAS one thread, here and in the processes started from here, unless the environment names a number.

    The variables alone would come too late: they are read when NumPy is loaded, and hhtbench loads it before it can tell
    a command from an import.  A BLAS other than OpenBLAS has only the variables.
    """
    if any(name in os.environ for name in THREADS):
        return
    os.environ.update(dict.fromkeys(THREADS, "1"))
    for set_threads in openblas("set"):
        set_threads(1)


def openblas(verb: str) -> Iterator[Callable[..., int]]:
    """The functions of every loaded OpenBLAS that ``get`` or ``set`` its number of threads."""
    for module in LINKED:
        library = ctypes.CDLL(module.__file__)  # finds the names of what it is linked with too
        yield from (getattr(library, name.format(verb)) for name in OPENBLAS if hasattr(library, name.format(verb)))


def worker_processes(jobs: int, **options: Any) -> ProcessPoolExecutor:
    """A pool of ``jobs`` fresh processes: JAX's threads do not survive a fork."""
    return ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=one_blas_thread, **options)
