"""What holds for all tests."""

import gc
import os

os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"  # XLA makes its code in half of the time, in child processes too

import jax

from hhtbench.runtime.processes import one_blas_thread

jax.config.update("jax_disable_most_optimizations", True)  # JAX may have been imported before
one_blas_thread()  # several pytest processes share the cores


def pytest_collection_finish() -> None:
    """What was imported stays: the garbage collector need not go through it while JAX traces, a tenth of all time."""
    gc.freeze()
