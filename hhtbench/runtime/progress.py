"""Progress of long commands on stderr: a bar with the remaining time on a terminal, plain lines in a file or a pipe."""

from __future__ import annotations

import os
import sys
import threading
import time
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from rich.progress import TaskID

EVERY = 30.0  # [s] between two lines in a file or a pipe
WINDOW = 600.0  # [s] of the past from which a bar estimates what is left: cells may take minutes
NO_CURSOR = ("dumb", "unknown")  # kinds of terminals on which no line can be drawn again


class Lines:
    """Progress as lines for a file or a pipe, every ``EVERY`` seconds and at the end of each part."""

    def __init__(self) -> None:
        self._part = ""
        self._began = self._drawn = 0.0
        self._first = 0
        self._pending = ""  # the newest state that was not printed

    def __enter__(self) -> Lines:
        return self

    def __exit__(self, *_: object) -> None:
        self._flush()

    def advance(self, part: str, done: int, total: int) -> None:
        """Report that ``done`` of ``total`` items of ``part`` are finished; ``total`` may grow."""
        now = time.monotonic()
        if part != self._part:
            self._flush()
            self._part, self._began, self._drawn, self._first = part, now, now, done
        left = (now - self._began) * (total - done) / (done - self._first) if done > self._first else 0.0
        self._pending = f"{part}: {done} of {total}" + (f", about {left:.0f} s left" if left > 0 else "")
        if now >= self._drawn + EVERY:
            self._drawn = now
            self._flush()

    def say(self, text: str) -> None:
        """Print a message on stderr."""
        click.echo(text, err=True)

    def show(self, text: str) -> None:
        """Print a line of the result on stdout."""
        click.echo(text)

    def _flush(self) -> None:
        if self._pending:
            click.echo(self._pending, err=True)
        self._pending = ""


class Bar:
    """Progress as a bar of the current part on a terminal, drawn by rich below the messages and removed at the end."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        words = TextColumn("{task.description}", markup=False)
        columns = words, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("left")
        # What goes to stdout is the result and may be in a pipe: it is never redirected to where the bar is.
        self._bars = Progress(
            *columns,
            console=Console(stderr=True),
            transient=True,
            redirect_stdout=False,
            speed_estimate_period=WINDOW,
        )
        self._part = ""
        self._task: TaskID | None = None
        self._lock = threading.Lock()  # a line comes from whatever thread has something to say

    def __enter__(self) -> Bar:
        self._start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.stop()

    def advance(self, part: str, done: int, total: int) -> None:
        """Report that ``done`` of ``total`` items of ``part`` are finished; ``total`` may grow."""
        with self._lock:
            if self._task is None or part != self._part:
                if self._task is not None:
                    self._bars.remove_task(self._task)  # one line only: rich erases as many above it when it starts again
                self._part, self._task = part, self._bars.add_task(part, total=total, completed=done)
            self._bars.update(self._task, total=total, completed=done)

    def say(self, text: str) -> None:
        """Print a message on stderr, above the bar."""
        self._above(text, err=True)

    def show(self, text: str) -> None:
        """Print a line of the result on stdout, above the bar."""
        self._above(text, err=False)

    def _above(self, text: str, err: bool) -> None:
        """Print a line above the bar, not through rich, which would wrap it at the terminal's width."""
        with self._lock:
            self._bars.stop()
            click.echo(text, err=err)
            self._start()

    def _start(self) -> None:
        self._bars.start()
        self._bars.console.show_cursor(True)  # a second Ctrl-C or a kill would leave the terminal without one


def progress() -> Lines | Bar:
    """Return a context manager that shows progress on stderr: a bar on a terminal, else lines."""
    terminal = sys.stderr is not None and sys.stderr.isatty() and os.environ.get("TERM") not in NO_CURSOR
    return Bar() if terminal else Lines()
