"""The parent's side of one worker process: start, hand over a task, notice its end, kill it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any

from hhtbench.processes import THREADS

START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[3]); "
    "from hhtbench.campaign.worker import serve; serve(int(sys.argv[1]), int(sys.argv[2]))"
)
OUTSIDE = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT)
PAGE = os.sysconf("SC_PAGE_SIZE")
MOST_SAID = 16 * 2**20  # bytes on stderr that are kept: a solver that writes without end must not fill the disk


class WorkerProcess:
    """One process with a session of its own, so that killing it takes its children along."""

    def __init__(self) -> None:
        ours, theirs = Pipe()
        assert isinstance(ours, Connection) and isinstance(theirs, Connection)  # noqa: S101 - for the type checker
        self.connection = ours
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 - it lives as long as the process
        flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false".strip()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-c", START, str(theirs.fileno()), str(os.getpid()), json.dumps(sys.path)],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=self._stderr,
                env={**os.environ, **dict.fromkeys(THREADS, "1"), "XLA_FLAGS": flags},
                start_new_session=True,
            )
        self.task: Any = None  #: what it works on
        self.tasks = 0  #: how many it was given
        self.worn = False  #: a task has left it in a state that could harm the next one
        self.ready = False
        self.phase = "starting"
        self.since = time.monotonic()  #: when the phase began

    def submit(self, task: Any, message: dict[str, Any]) -> None:
        """Hand over a task; a worker that has died meanwhile is noticed by :meth:`receive`."""
        self.task, self.phase, self.since = task, "loading", time.monotonic()
        self.tasks += 1
        self._stderr.seek(0)
        self._stderr.truncate()
        with suppress(OSError):
            self.connection.send_bytes(json.dumps(message).encode())

    def receive(self) -> dict[str, Any] | None:
        """The result, if it has arrived; phases on the way are noted.  EOFError where the worker is gone."""
        try:
            while self.connection.poll():
                message = json.loads(self.connection.recv_bytes())
                self.since = time.monotonic()
                self.phase = message.get("phase", self.phase)
                self.ready = self.ready or "ready" in message
                self.worn = message.get("worn", False)
                if "result" in message:
                    return dict(message["result"])
            self._drop_flood()
        except (OSError, ValueError) as error:
            raise EOFError from error
        if self._process.poll() is not None:
            raise EOFError
        return None

    def _drop_flood(self) -> None:
        file = self._stderr.fileno()
        if os.fstat(file).st_size > MOST_SAID:
            os.ftruncate(file, 0)
            os.lseek(file, 0, os.SEEK_SET)  # the worker writes where its parent is: they share the place

    def resident(self) -> int:
        """Memory in use [bytes]; 0 where the system does not say."""
        try:
            return int(Path(f"/proc/{self._process.pid}/statm").read_text().split()[1]) * PAGE
        except (OSError, IndexError, ValueError):
            return 0

    @property
    def killed_by(self) -> signal.Signals | None:
        """The signal by which others end processes, if it ended by one; a process that ends itself has other ways."""
        code = self._process.poll()
        return next((number for number in OUTSIDE if code == -number), None)

    def kill(self) -> None:
        """End the process and its children at once."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self.connection.close()
        self._stderr.close()

    def last_words(self) -> str:
        """How it ended: exit code or signal, and what it wrote on stderr about it."""
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
        """From faulthandler's report the error and the innermost lines, else the last line."""
        size = self._stderr.seek(0, os.SEEK_END)
        self._stderr.seek(max(0, size - 4000))
        lines = [line.strip() for line in self._stderr.read().decode(errors="replace").splitlines() if line.strip()]
        fatal = [i for i, line in enumerate(lines) if line.startswith("Fatal Python error")]
        if fatal:
            places = [line for line in lines[fatal[-1] :] if line.startswith("File ")]
            return "; ".join([lines[fatal[-1]], *places[:2]])
        return lines[-1][:300] if lines else ""
