"""What holds for all tests."""

import gc

from hhtbench.processes import one_blas_thread

one_blas_thread()  # several pytest processes share the cores


def pytest_collection_finish() -> None:
    """What was imported stays: the garbage collector need not go through it while JAX traces, a tenth of all time."""
    gc.freeze()
