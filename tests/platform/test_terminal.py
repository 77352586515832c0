"""A person at a terminal is told what takes long; nobody else is."""

import io
import sys
import time

import pytest

from hhtbench.runtime import terminal
from hhtbench.solution.counting import preparing


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def impatient(monkeypatch):
    monkeypatch.setattr(terminal, "PATIENCE", 0.1)
    monkeypatch.setattr(terminal, "LOOK", 0.01)


def test_a_terminal_shows_once_what_is_being_prepared_for_long_and_not_what_was_quick(impatient, monkeypatch):
    shown = Terminal()
    monkeypatch.setattr(sys, "stderr", shown)
    end = time.monotonic() + 10
    with preparing("tracing a quick one"):
        pass
    with preparing("compiling force by XLA"), preparing("tracing force"):
        while shown.getvalue().count("\n") < 2:
            assert time.monotonic() < end
            time.sleep(0.01)
        time.sleep(0.2)
    assert shown.getvalue() == "hhtbench: compiling force by XLA ...\nhhtbench: tracing force ...\n"


def test_a_file_or_a_pipe_shows_nothing(impatient, monkeypatch):
    written = io.StringIO()
    monkeypatch.setattr(sys, "stderr", written)
    with preparing("compiling force by XLA"):
        time.sleep(0.3)
    assert written.getvalue() == ""
