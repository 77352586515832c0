"""Announce on the terminal work that takes long, while it runs."""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from threading import Event, Thread

PATIENCE = 2.0  # [s] before a line is printed
LOOK = 0.25  # [s] between two checks of what is under way


class announced_when_slow:
    """Context manager that prints "compiling force ..." on a terminal once its body has run for ``PATIENCE`` seconds.

    One thread polls while any body runs and sleeps otherwise: 3 us per use, where a timer of its own takes 0.7 ms.
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._stream = sys.stderr
        self._due = float("inf")

    def __enter__(self) -> None:
        if self._stream is None or not self._stream.isatty():
            return
        self._due = time.monotonic() + PATIENCE
        _under_way.append(self)
        _begun.set()
        if _watcher.ident is None:
            with suppress(RuntimeError):  # another thread has just started it
                _watcher.start()

    def __exit__(self, *_: object) -> None:
        if self in _under_way:
            _under_way.remove(self)

    def print_if_due(self) -> None:
        """Print the line if its time has come; only once."""
        if time.monotonic() >= self._due:
            self._due = float("inf")
            with suppress(OSError, ValueError):  # the terminal is gone or closed
                self._stream.write(f"hhtbench: {self._what} ...\n")
                self._stream.flush()


_under_way: list[announced_when_slow] = []
_begun = Event()  #: something may be under way


def _watch() -> None:
    while _begun.wait():
        time.sleep(LOOK)
        _begun.clear()  # before the look: what begins after it is not missed
        for each in tuple(_under_way):
            each.print_if_due()
        if _under_way:
            _begun.set()


_watcher = Thread(target=_watch, name="hhtbench terminal", daemon=True)
