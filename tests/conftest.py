"""What holds for all tests."""

import gc
from collections.abc import Iterator

import jax
import pytest

from hhtbench.runtime.processes import one_blas_thread

one_blas_thread()  # several pytest processes share the cores


def pytest_collection_finish() -> None:
    """What was imported stays: the garbage collector need not go through it while JAX traces, a tenth of all time."""
    gc.freeze()


@pytest.fixture(scope="module")
def quick_xla() -> Iterator[None]:
    """XLA makes its code in half of the time: for tests that compare what it computes, and not how fast."""
    before = jax.config.values["jax_disable_most_optimizations"]
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", before)
