"""Executor on a Dask cluster; the only module that needs the extra ``hhtbench[dask]``."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

from distributed import Client

from hhtbench.protocol.errors import ProblemError

CONNECT = 30.0  # s to reach the scheduler


@contextmanager
def cluster_executor(address: str) -> Iterator[Executor]:
    """Context manager with the executor of the Dask cluster whose scheduler is at ``address``.

    Each of its workers starts processes of its own for the tasks, with limited time and memory.  A task whose
    worker is lost runs again on another: at least once, while the store takes its first row only.

    Raises
    ------
    ProblemError
        No scheduler answers there.
    """
    try:
        client = Client(address, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:  # a timeout is an OSError
        raise ProblemError(f"no Dask scheduler answers at {address}: {error}") from error
    with client:
        yield client.get_executor(pure=False)  # a retried task is to run, not to be remembered
