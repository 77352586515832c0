"""Benchmarks.  BLAS has one thread in them, for the reason that hhtbench/runtime/processes.py gives."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy is loaded: the imports are timed too
