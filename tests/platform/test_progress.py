"""A person at a terminal sees a bar with the remaining time, a file gets plain lines, the result goes to stdout alone."""

import io
import re
import sys

import pytest

from hhtbench.runtime import progress as module
from hhtbench.runtime.progress import Bar, Lines, progress

LONG = "a line that is much longer than the terminal is wide " * 4
SHOWN, HIDDEN = "\x1b[?25h", "\x1b[?25l"


class Terminal(io.StringIO):
    def isatty(self):
        return True


def at_a_terminal(monkeypatch):
    """What it shows from here on; pytest's capturing would take a fixture's stderr away before the test begins."""
    shown = Terminal()
    monkeypatch.setattr(sys, "stderr", shown)
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    return shown


@pytest.fixture
def seconds(monkeypatch):
    """What the clock says."""
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    return now


def test_a_file_or_a_pipe_gets_a_line_now_and_then_and_one_at_the_end_of_each_part(seconds, capsys):
    with progress() as told:
        assert isinstance(told, Lines)
        for done in range(11):
            told.advance("accuracy", done, 10)
            seconds[0] += 10.0
        told.advance("timing", 0, 4)
        told.say("something happened")
        told.show("a row of the result")
        told.advance("timing", 4, 4)
    out, err = capsys.readouterr()
    assert out == "a row of the result\n"
    assert err.splitlines() == [
        "accuracy: 3 of 10, about 70 s left",
        "accuracy: 6 of 10, about 40 s left",
        "accuracy: 9 of 10, about 10 s left",
        "accuracy: 10 of 10",
        "something happened",
        "timing: 4 of 4",
    ]


def test_a_terminal_shows_a_bar_with_the_remaining_time_that_is_gone_at_the_end(monkeypatch):
    terminal = at_a_terminal(monkeypatch)
    with progress() as told:
        assert isinstance(told, Bar)
        told.advance("accuracy", 0, 10)
        for done in range(1, 6):
            told.advance("accuracy", done, 10)
        told.say("something happened")
    last = re.sub(r"\x1b\[[\d;]*m", "", terminal.getvalue()).split("\r")[-2]
    assert re.search(r"accuracy .*━.* 5/10 0:00:0\d left\n", last), last
    assert "/100" not in terminal.getvalue(), "no other total is shown for a moment"
    assert terminal.getvalue().endswith("\x1b[1A\x1b[2K"), "its line is erased"


def test_what_is_said_beside_a_bar_is_whole_and_the_result_goes_to_stdout(monkeypatch):
    terminal = at_a_terminal(monkeypatch)
    with progress() as told:
        told.advance("rows", 0, 2)
        told.say(LONG)
        told.show("[bold]" + LONG)
        print("a result of somebody else's")  # noqa: T201
        told.advance("rows", 1, 2)
    assert f"{LONG}\n" in terminal.getvalue()
    assert sys.stdout.getvalue() == f"[bold]{LONG}\na result of somebody else's\n"


def test_a_terminal_keeps_its_cursor_whenever_the_process_is_killed(monkeypatch):
    terminal = at_a_terminal(monkeypatch)
    with progress() as told:
        for done in range(3):
            told.advance("accuracy", done, 2)
            told.say("something")
            assert terminal.getvalue().rindex(SHOWN) > terminal.getvalue().rindex(HIDDEN)


def test_a_terminal_that_cannot_draw_a_line_again_gets_plain_lines(monkeypatch):
    at_a_terminal(monkeypatch)
    monkeypatch.setenv("TERM", "dumb")
    assert isinstance(progress(), Lines)


def test_where_more_is_done_than_was_expected_nothing_is_said_of_what_is_left(seconds, capsys):
    with progress() as told:
        for done in (0, 4, 9):
            told.advance("seconds", done, 5)
            seconds[0] += 40.0
    assert capsys.readouterr().err.splitlines() == ["seconds: 4 of 5, about 10 s left", "seconds: 9 of 5"]
