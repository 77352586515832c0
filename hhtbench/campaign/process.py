"""Parent's side of a campaign's worker process: submit a task, follow its phases, notice its end."""

from __future__ import annotations

import json
import os
import signal
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from hhtbench.runtime.processes import Process

OUTSIDE = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT)
PAGE = os.sysconf("SC_PAGE_SIZE")
MOST_SAID = 16 * 2**20  # bytes on stderr that are kept: a solver that writes without end must not fill the disk


class WorkerProcess(Process):
    """Handle of one process that runs :mod:`hhtbench.campaign.worker`."""

    def __init__(self) -> None:
        super().__init__("hhtbench.campaign.worker")
        self.task: Any = None  #: what it works on
        self.tasks = 0  #: how many it was given
        self.worn = False  #: a task has left it in a state that could harm the next one
        self.ready = False
        self.phase = "starting"
        self.since = time.monotonic()  #: when the phase began

    def submit(self, task: Any, message: dict[str, Any]) -> None:
        """Send a task; if the worker has died, :meth:`receive` notices."""
        self.task, self.phase, self.since = task, "loading", time.monotonic()
        self.tasks += 1
        self._stderr.seek(0)
        self._stderr.truncate()
        with suppress(OSError):
            self.connection.send_bytes(json.dumps(message).encode())

    def receive(self) -> dict[str, Any] | None:
        """Return the result if it has arrived, else None, and record the current phase; EOFError if the worker is gone."""
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
        """Return the resident memory [bytes]; 0 if the system does not report it."""
        try:
            return int(Path(f"/proc/{self._process.pid}/statm").read_text().split()[1]) * PAGE
        except (OSError, IndexError, ValueError):
            return 0

    @property
    def killed_by(self) -> signal.Signals | None:
        """The signal from outside that ended the process, or None."""
        code = self._process.poll()
        return next((number for number in OUTSIDE if code == -number), None)
