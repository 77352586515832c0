"""The processes that hhtbench starts, its commands, workers and benchmarks: in each of them BLAS has one thread.

The matrices here are small.  A second thread gains nothing and waits for a core that another process has: with two threads
on two cores, one of them busy with another process, a solve of 160 equations takes 6 to 15 ms in the mean instead of 0.3.
The number is set once per process and never by a solve: it belongs to all its threads.  XLA's own threads are left alone.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_context
from typing import Any

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
LINKED = ("numpy.linalg._umath_linalg", "scipy.linalg.cython_lapack")  # with BLAS: NumPy and SciPy bring a copy each
OPENBLAS = (
    "scipy_openblas_{}_num_threads64_",
    "scipy_openblas_{}_num_threads",
    "openblas_{}_num_threads64_",
    "openblas_{}_num_threads",
)


def one_blas_thread() -> None:
    """Give BLAS one thread, here and in the processes started from here, unless the environment names a number.

    A command has not loaded NumPy yet, and the variables are enough.  They would come too late for the worker of a
    caller's own pool, which has run the caller's main module, and for pytest: what is loaded is told as well.  A BLAS other
    than OpenBLAS has only the variables.
    """
    if any(name in os.environ for name in THREADS):
        return
    os.environ.update(dict.fromkeys(THREADS, "1"))
    for set_threads in openblas("set"):
        set_threads(1)


def openblas(verb: str) -> Iterator[Callable[..., int]]:
    """The functions of every loaded OpenBLAS that ``get`` or ``set`` its number of threads."""
    for module in filter(None, map(sys.modules.get, LINKED)):
        library = ctypes.CDLL(module.__file__)  # finds the names of what it is linked with too
        yield from (getattr(library, name.format(verb)) for name in OPENBLAS if hasattr(library, name.format(verb)))


@contextmanager
def worker_processes(jobs: int, **options: Any) -> Iterator[ProcessPoolExecutor]:
    """A pool of ``jobs`` fresh processes: JAX's threads do not survive a fork.

    An exception inside, as an interruption, kills them: what they do and what waits for them is not waited for.
    """
    others = set(active_children())
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=one_blas_thread, **options) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in set(active_children()) - others:
                process.kill()
            raise
