"""Handle Ctrl-C, SIGTERM and SIGHUP: end a command with the shells' exit code, 128 plus the signal's number.

An exception raised wherever Python happens to be, its default, is lost in libraries that catch everything on import.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupted(KeyboardInterrupt):
    """A signal was received; ``code`` is the exit code."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.code = 128 + number


@contextmanager
def ends_at_once(message: str = "") -> Iterator[None]:
    """Context manager in which a signal ends the process at once: for imports and other work without clean-up."""
    with _handled(lambda number: _leave(number, message)):
        yield


@contextmanager
def ends_in_order(message: str = "") -> Iterator[None]:
    """Context manager in which the first signal raises :class:`Interrupted`, for clean-up, and a second ends the process."""
    came: list[int] = []

    def handle(number: int) -> None:
        came.append(number)
        if len(came) > 1:
            _leave(number, message)
        raise Interrupted(number)

    with _handled(handle):
        yield


def _leave(number: int, message: str) -> None:
    if message and sys.stderr is not None:
        os.write(2, f"\n{message}\n".encode(errors="replace"))
    os._exit(128 + number)


@contextmanager
def _handled(action: Callable[[int], None]) -> Iterator[None]:
    """Context manager that passes signals to ``action``; ignored ones (nohup) stay ignored, other threads receive none."""

    def handle(number: int, _: FrameType | None) -> None:
        action(number)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before: dict[Any, Any] = {number: signal.getsignal(number) for number in SIGNALS}
    try:
        for number in SIGNALS:
            if before[number] is not signal.SIG_IGN:
                signal.signal(number, handle)
        yield
    finally:
        for number in SIGNALS:
            if before[number] is not None:
                signal.signal(number, before[number])
