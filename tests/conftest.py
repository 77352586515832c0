"""What holds for all tests."""

from hhtbench.processes import one_blas_thread

one_blas_thread()  # several pytest processes share the cores
