"""Scripts without ``if __name__ == "__main__"``, standard input, scripts that name themselves, and Problem objects."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import hhtbench as hb

FALL = """\
import numpy as np
import hhtbench as hb

print("executed")

def exact(t):
    return hb.Motion(np.array([1 - 4.905 * t**2]), np.array([-9.81 * t]), np.zeros(0), np.zeros(0))

system = hb.NumpySystem(force=lambda t, q, v: 0 * q - 9.81)
fall = hb.Problem(name="fall", system=system, t_span=(0.0, 1.0), q0=[1.0], v0=[0.0], exact=exact)
"""
ASKED = "'scipy(method=DOP853)', rtol=[1e-3], timing=False, jobs=1"
RUN = f"print([row.status for row in hb.run({{}}, {ASKED}).rows])\n"
TRADE = "found = hb.trade({}, accuracies=[1e-2], solvers='scipy(method=DOP853)', on='evaluations', jobs=1)\nprint(found)\n"
CERTIFIED = """\
from pathlib import Path
from hhtbench.campaign.reference import certified
print(certified({"knife_edge": "0"}, Path("references"), 1, print))
"""
MADE = "({}, {'knife_edge': 'the problem brings its own'})\n"


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "fall.py").write_text(FALL)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def said_by(*command: str, text: str = "") -> subprocess.CompletedProcess[str]:
    """What Python says, given ``text`` on standard input."""
    return subprocess.run([sys.executable, *command], input=text, capture_output=True, text=True, timeout=100)


def test_references_are_made_from_standard_input(here):
    found = said_by("-", text=CERTIFIED)
    assert found.stdout == MADE, found.stderr


def test_a_script_without_a_guard_makes_references_and_is_told_where_it_names_itself(here):
    """In every cell of a run; a trade is refused before anything runs."""
    run, trade = RUN.replace("row.status", "row.message").format("'me.py:fall'"), TRADE.format("'me.py:fall'")
    (here / "me.py").write_text(FALL + run + CERTIFIED + trade)
    found = said_by("me.py")
    told = "me.py, line 11, raised ProblemError"
    executed, message, *made = found.stdout.splitlines(keepends=True)
    assert (executed, made) == ("executed\n", [MADE, "executed\n"]), found.stderr
    assert message.count("hb.run and hb.trade cannot be called while me.py is loaded") == 1
    assert told in message and 'under `if __name__ == "__main__":`' in message
    assert found.returncode == 1
    assert found.stderr.splitlines()[-1].startswith(f"hhtbench.protocol.errors.ProblemError: {told}: hb.run")


def test_a_function_of_a_problem_cannot_start_a_campaign(here):
    (here / "fall.py").write_text(FALL.replace("0 * q - 9.81", "hb.run('fall.py:fall', 'hht', rtol=[1e-3])"))
    (row,) = hb.run("fall.py:fall", "scipy(method=DOP853)", rtol=[1e-3], timing=False, jobs=1).rows
    assert "hb.run and hb.trade cannot be called in a worker process" in row.message


@pytest.mark.long
def test_problem_objects_of_a_script_are_run_and_traded_in_its_process_which_is_said(here):
    run, trade = RUN.format("fall"), TRADE.format("fall")
    found, other = said_by("-", text=FALL + run), said_by("-c", f"exec({FALL + run + trade!r}, {{'__name__': '__main__'}})")
    assert found.stdout == "executed\n['success']\n", found.stderr
    assert other.stdout.startswith(found.stdout), other.stderr
    assert "Take scipy(method=DOP853): rtol" in other.stdout and "in one process" in other.stdout
    said = [
        one.stderr.count("No imported file holds the Problem fall: all was solved in one process") for one in (found, other)
    ]
    assert said == [1, 2]


def test_a_problem_object_of_an_imported_file_is_named_by_it_until_the_file_changes(here):
    run, change = RUN.format("fall"), "open('fall.py', 'a').write('fall = None')\n"
    found = said_by("-", text=f"import os\nos.utime('fall.py', (0, 0))\nfrom fall import fall, hb\n{run}{change}{run}")
    assert found.stdout == "executed\n" + 2 * "['success']\n", found.stderr
    assert found.stderr.count("No imported file holds") == 1


@pytest.mark.long
def test_a_problem_object_gives_the_numbers_that_its_file_gives(here):
    fall = hb.load_problem("fall.py:fall")
    asked = {"rtol": [1e-3, 1e-5], "timing": False, "jobs": 1}
    with pytest.warns(UserWarning, match="No imported file holds the Problem fall"):
        ours = hb.run(fall, "scipy(method=DOP853)", **asked).table()
    theirs = hb.run("fall.py:fall", "scipy(method=DOP853)", **asked).table()
    assert [row["problem"] for row in ours] == ["fall"] * 2
    for row, other in zip(ours, theirs, strict=True):
        assert {**row, "problem": "", "time": 0} == {**other, "problem": "", "time": 0}


def test_what_cannot_be_kept_or_told_apart_is_refused(here, tmp_path):
    fall = hb.load_problem("fall.py:fall")
    with pytest.raises(hb.ProblemError, match="store needs a problem that a file names"):
        hb.trade(fall, store=tmp_path / "runs.sqlite")
    with ThreadPoolExecutor() as threads, pytest.raises(hb.ProblemError, match="executor needs a problem that a file names"):
        hb.run(fall, "hht", rtol=[1e-3], executor=threads)
    with pytest.raises(hb.ProblemError, match="two different problems are named fall"):
        hb.run([fall, fall.starting(q0=[2.0])], "hht", rtol=[1e-3])
    with pytest.raises(TypeError, match="a problem must be a spec"):
        hb.run(3, "hht", rtol=[1e-3])
