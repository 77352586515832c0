"""What holds for all tests."""

import gc
import os

os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"  # XLA makes its code in half of the time, in child processes too

import jax
import pytest

from hhtbench.runtime.processes import one_blas_thread

jax.config.update("jax_disable_most_optimizations", True)  # JAX may have been imported before
one_blas_thread()  # several pytest processes share the cores


@pytest.fixture(autouse=True, scope="module")
def _what_is_there_stays() -> None:
    """The garbage collector need not go through imports and earlier files' compiled functions again and again."""
    gc.collect()  # what is frozen as garbage is never freed
    gc.freeze()
