"""What SUNDIALS says, for the status and not for the terminal: the one file that knows how it is printed.

Warnings are written by SUNDIALS itself, in C, into the file that its variable names.  Errors come through scikit-sundae,
which calls Python's ``print`` in the thread that took the step.  Its compiled code holds ``print`` itself, so that only
the stream can be listened at.  ``sys.stdout`` is not replaced: where two threads do so one of them restores the other's.
"""

from __future__ import annotations

import os
import re
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

os.environ.setdefault("SUNLOGGER_WARNING_FILENAME", os.devnull)  # read when a solver is made; else it is stdout

PRINTED = re.compile(r"\n\[\w+, Error: -?\d+\] .*\n", re.DOTALL)  # by _sunerr_handler of sksundae/_cy_common.pyx


class _Here(threading.local):
    """What is heard in one thread."""

    said: list[str] | None = None  #: None: nobody listens
    newline = False  #: ``print`` has yet to write the newline that ends a message


_here = _Here()
_lock = threading.Lock()
_ears: dict[int, _Ear] = {}  # by id of the stream


@contextmanager
def overheard() -> Iterator[list[str]]:
    """The errors that SUNDIALS prints in this thread; all else that is written to stdout passes."""
    said: list[str] = []
    before, ear = _here.said, _listen(sys.stdout)
    _here.said = said
    try:
        yield said
    finally:
        _here.said = before
        if ear is not None:
            _leave(ear)


class _Ear:
    """The ``write`` of a stream while threads listen at it."""

    def __init__(self, stream: Any) -> None:
        self.stream, self.write, self.listeners = stream, stream.write, 0
        self.own = vars(stream).get("write")  #: what stood in the place of the method before

    def __call__(self, text: str) -> Any:
        if _here.said is not None and isinstance(text, str) and PRINTED.fullmatch(text):
            _here.said.append(text.strip())
            _here.newline = True
            return len(text)
        ends, _here.newline = _here.newline and text == "\n", False
        return len(text) if ends else self.write(text)


def _listen(stream: Any) -> _Ear | None:
    """The ear at ``stream``, with one more listener; None at a stream without attributes of its own, which is left alone."""
    if not hasattr(stream, "__dict__"):
        return None
    with _lock:
        ear = _ears.get(id(stream))
        if ear is None:
            ear = _ears[id(stream)] = _Ear(stream)
            stream.write = ear
        ear.listeners += 1
        return ear


def _leave(ear: _Ear) -> None:
    """One listener less; with the last the stream is as it was."""
    with _lock:
        ear.listeners -= 1
        if ear.listeners:
            return
        del _ears[id(ear.stream)]
        if vars(ear.stream).get("write") is ear:  # else somebody has put another in its place
            del ear.stream.write
            if ear.own is not None:
                ear.stream.write = ear.own
