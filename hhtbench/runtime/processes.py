"""Start commands, workers and benchmarks as processes in which BLAS has one thread.

The matrices here are small.  A second thread gains nothing and waits for a core that another process has: with two threads
on two cores, one of them busy with another process, a solve of 160 equations takes 6 to 15 ms in the mean instead of 0.3.
The number is set once per process and never by a solve: it belongs to all its threads.  XLA's own threads are left alone.
"""

from __future__ import annotations

import ctypes
import faulthandler
import json
import os
import pickle
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, Pipe
from queue import SimpleQueue
from traceback import format_exc
from typing import Any

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
LINKED = ("numpy.linalg._umath_linalg", "scipy.linalg.cython_lapack")  # with BLAS: NumPy and SciPy bring a copy each
START = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from {} import serve; serve(*map(int, sys.argv[2:]))"
WORKER = "HHTBENCH_WORKER"  #: environment variable of every worker process and of what it starts
SET_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of prctl(2)
OPENBLAS = (
    "scipy_openblas_{}_num_threads64_",
    "scipy_openblas_{}_num_threads",
    "openblas_{}_num_threads64_",
    "openblas_{}_num_threads",
)


def one_blas_thread() -> None:
    """Limit BLAS to one thread in this process and its children, unless an environment variable sets the number.

    Environment variables are enough before NumPy is loaded, as in a command.  In pytest NumPy is loaded already, so loaded
    libraries are set too; a BLAS other than OpenBLAS has only the variables.
    """
    if any(name in os.environ for name in THREADS):
        return
    os.environ.update(dict.fromkeys(THREADS, "1"))
    for set_threads in openblas("set"):
        set_threads(1)


def openblas(verb: str) -> Iterator[Callable[..., int]]:
    """Yield the functions of every loaded OpenBLAS that ``get`` or ``set`` (``verb``) its number of threads."""
    for module in filter(None, map(sys.modules.get, LINKED)):
        library = ctypes.CDLL(module.__file__)  # finds the names of what it is linked with too
        yield from (getattr(library, name.format(verb)) for name in OPENBLAS if hasattr(library, name.format(verb)))


class Process:
    """A fresh process that runs ``serve(descriptor, parent)`` of a module, at the other end of ``connection``.

    It does not import the caller's main module, so that a script needs no ``if __name__ == "__main__"``.  It has a session
    of its own, so that killing it ends its children too.
    """

    def __init__(self, module: str) -> None:
        ours, theirs = Pipe()
        assert isinstance(ours, Connection) and isinstance(theirs, Connection)  # noqa: S101 - for the type checker
        self.connection = ours
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 - it lives as long as the process
        flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false".strip()
        command = [sys.executable, "-c", START.format(module), json.dumps(sys.path), str(theirs.fileno()), str(os.getpid())]
        with theirs:
            self._process = subprocess.Popen(
                command,
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=self._stderr,
                env={**os.environ, **dict.fromkeys(THREADS, "1"), "XLA_FLAGS": flags, WORKER: "1"},
                start_new_session=True,
            )

    def interrupt(self) -> None:
        """Send SIGKILL to the process and its children."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)

    def kill(self) -> None:
        """Kill the process and its children, wait for the end and close the connection."""
        self.interrupt()
        self._process.wait()
        self.connection.close()
        self._stderr.close()

    def last_words(self) -> str:
        """Return how the process ended: exit code or signal, and its last output on stderr."""
        try:
            code = self._process.wait(timeout=1.0)  # the pipe closes a moment before the process ends
        except subprocess.TimeoutExpired:
            return "the pipe to the worker closed"
        text = f"exit code {code}"
        if code < 0:
            with suppress(ValueError):
                text = f"signal {signal.Signals(-code).name}"
        said = self._said()
        return f"{text}; {said}" if said else text

    def _said(self) -> str:
        """Return faulthandler's error with its innermost lines from stderr, else the last line of stderr."""
        size = self._stderr.seek(0, os.SEEK_END)
        self._stderr.seek(max(0, size - 4000))
        lines = [line.strip() for line in self._stderr.read().decode(errors="replace").splitlines() if line.strip()]
        fatal = [i for i, line in enumerate(lines) if line.startswith("Fatal Python error")]
        if fatal:
            places = [line for line in lines[fatal[-1] :] if line.startswith("File ")]
            return "; ".join([lines[fatal[-1]], *places[:2]])
        return lines[-1][:300] if lines else ""


def opened(descriptor: int, parent: int) -> Connection:
    """Open a new process's end of the pipe; from then on it ends with ``parent``, and a crash prints its line on stderr."""
    if sys.platform == "linux":  # even while hanging in C; elsewhere the closed pipe has to do
        ctypes.CDLL(None).prctl(SET_DEATH_SIGNAL, signal.SIGKILL)
    if os.getppid() != parent:
        sys.exit(1)
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # it ends the worker from outside; KeyboardInterrupt is a plugin's own
    faulthandler.enable(all_threads=False)
    os.set_inheritable(descriptor, False)
    return Connection(descriptor)


def serve(descriptor: int, parent: int) -> None:
    """Main loop of a worker of :func:`worker_processes`: answer calls until the pipe closes."""
    connection = opened(descriptor, parent)
    while True:
        try:
            call = connection.recv_bytes()
        except (EOFError, OSError):
            return
        connection.send_bytes(_answer(call))


def _answer(call: bytes) -> bytes:
    try:
        function, arguments = pickle.loads(call)
        return pickle.dumps((function(*arguments), None))
    except Exception as error:  # noqa: BLE001 - it is raised where the call came from
        error.add_note(format_exc())
        with suppress(Exception):
            answer = pickle.dumps((None, error))
            pickle.loads(answer)  # not every exception survives it
            return answer
        return pickle.dumps((None, RuntimeError(f"{type(error).__name__}: {error}")))


class Worker:
    """One process at a time that calls functions; a process that dies or is killed is replaced at the next call."""

    def __init__(self) -> None:
        self._stopped = False
        self._process: Process | None = None

    def call(self, function: Callable[..., Any], *arguments: Any, seconds: float | None = None) -> Any:
        """Call ``function(*arguments)`` in the process and return or raise its result; its module is imported there by
        name.

        Raises
        ------
        TimeoutError
            It did not answer within ``seconds`` [s]; it was killed.
        EOFError
            The process died.
        CancelledError
            The worker was stopped.
        """
        if self._stopped:
            raise CancelledError
        if self._process is None:
            self._process = Process(__name__)
        process = self._process
        try:
            if self._stopped:  # while the process started
                raise EOFError
            process.connection.send_bytes(pickle.dumps((function, arguments)))
            if not process.connection.poll(seconds):
                self.end()
                raise TimeoutError(f"no answer in {seconds:g} s")
            found, error = pickle.loads(process.connection.recv_bytes())
        except (EOFError, ConnectionError):
            words = process.last_words()
            self.end()
            raise CancelledError if self._stopped else EOFError(f"its process ended: {words}") from None
        if error is not None:
            raise error
        return found

    def stop(self) -> None:
        """Kill the process, from another thread; it is not replaced."""
        self._stopped, process = True, self._process
        if process is not None:
            process.interrupt()

    def end(self) -> None:
        """Kill the process, if there is one."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()


class Inline(Executor):
    """Executor that calls functions immediately in this thread."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **_: Any) -> Future[Any]:
        """Call ``fn(*args)`` now and return a finished future."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args))
        except Exception as error:  # noqa: BLE001 - raised where the result is asked for
            future.set_exception(error)
        return future


class Workers(Executor):
    """Executor whose threads have a :class:`Worker` each; a process that dies fails only its own call."""

    def __init__(self, jobs: int, fresh: bool) -> None:
        self.workers = [Worker() for _ in range(jobs)]
        self.threads = ThreadPoolExecutor(jobs)
        self._fresh = fresh
        self._idle: SimpleQueue[Worker] = SimpleQueue()
        for worker in self.workers:
            self._idle.put(worker)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **_: Any) -> Future[Any]:
        """Call ``fn(*args)`` in a worker process and return the future."""
        return self.lend(lambda worker: worker.call(fn, *args))

    def lend(self, use: Callable[[Worker], Any]) -> Future[Any]:
        """Call ``use(worker)`` in a thread of this process and return the future."""
        return self.threads.submit(self._lent, use)

    def _lent(self, use: Callable[[Worker], Any]) -> Any:
        worker = self._idle.get()
        try:
            return use(worker)
        finally:
            if self._fresh:
                worker.end()
            self._idle.put(worker)


@contextmanager
def worker_processes(jobs: int, *, fresh: bool = False) -> Iterator[Workers]:
    """Context manager with a pool of ``jobs`` spawned processes, with ``fresh`` a new one per call (JAX does not survive a
    fork).

    An exception inside, such as an interruption, kills the processes and cancels waiting calls.
    """
    pool = Workers(jobs, fresh)
    try:
        with pool.threads:
            try:
                yield pool
            except BaseException:
                pool.threads.shutdown(wait=False, cancel_futures=True)
                for worker in pool.workers:
                    worker.stop()
                raise
    finally:
        for worker in pool.workers:
            worker.end()
