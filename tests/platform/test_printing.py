"""What people read: numbers as they write them, objects in a line, tables that fit the terminal, hints that can be typed."""

from __future__ import annotations

import copy
import re
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest
from click.testing import CliRunner

import hhtbench as hb
from hhtbench.cli.main import main
from hhtbench.protocol.printing import exact


@pytest.mark.parametrize(
    ("x", "text"), [(0.96, "0.96"), (10.0, "10"), (1e-8, "1e-08"), (np.float64(0.1) + 0.2, "0.30000000000000004")]
)
def test_a_number_is_printed_as_short_as_reads_back(x, text):
    assert exact(x) == text
    assert float(exact(x)) == x


def test_objects_are_printed_in_a_line_and_shown_by_notebooks():
    problem = hb.load_problem("simple_pendulum")
    solution = hb.solve(problem, rtol=1e-3)
    runs = hb.run("simple_pendulum", "hht", rtol=[1e-2], jobs=1, timing=False)
    found = [problem, hb.check(problem), solution.drift(), runs, hb.select(problem, accuracy=1e-3)]
    for each in found:
        assert re.fullmatch(rf"<{type(each).__name__}[ :,].*>", repr(each)), repr(each)
        assert len(repr(each)) < 400
        assert each._repr_html_().startswith("<")
    assert "position" in repr(solution.drift())
    assert "<table>" in hb.check(problem)._repr_html_()
    assert str(hb.check(problem)).endswith("claims hold")


@pytest.mark.parametrize("columns", [80, 120])
def test_a_table_of_claims_fits_the_terminal(columns, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(columns))
    lines = CliRunner().invoke(main, ["check", "simple_pendulum"]).output.splitlines()
    assert max(map(len, lines)) <= columns
    assert any("position" in line for line in lines)


def test_a_reader_that_closes_its_end_is_no_error():
    """As ``hhtbench check ... | head``."""
    command = [sys.executable, "-c", "from hhtbench.cli.main import main; main()", "check", "simple_pendulum"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        process.stdout.close()  # before anything is written
        assert process.stderr.read() == ""


@pytest.mark.parametrize(
    ("solver", "hint"),
    [
        ("DOP853", r"Did you mean projected\(method=DOP853\) or scipy\(method=DOP853\)\?"),
        ("radau", r"Did you mean scipy\(method=Radau\)\?"),
        ("adams", r"Did you mean cvode\(method=adams\)\?"),
        ("idaa", r"Did you mean ida\?"),
        ("hht(aplha=-0.1)", r"Did you mean alpha\?"),
        ("scipy(method=radau)", r"Did you mean Radau\?"),
    ],
)
def test_a_wrong_name_leads_to_one_that_can_be_typed(solver, hint):
    with pytest.raises((hb.ProblemError, TypeError), match=hint) as caught:
        hb.solve("simple_pendulum", solver, rtol=1e-3)
    for typed in re.findall(r"\w+\(method=\w+\)", str(caught.value)):
        assert hb.solve("simple_pendulum", typed, rtol=1e-6).success


def test_a_wrong_option_of_a_request_leads_to_the_right_one():
    with pytest.raises(TypeError, match=r"Did you mean rtol\?"):
        hb.solve("simple_pendulum", rto=1e-3)
    with pytest.raises(TypeError, match=r"known: accuracy, .*Did you mean accuracy\?"):
        hb.solve("simple_pendulum", acuracy=1e-3)


def test_only_a_problem_without_scales_is_said_to_declare_none():
    given = {"system": hb.load_problem("simple_pendulum").system, "t_span": (0, 1), "q0": [1, 0], "v0": [0, 0]}
    own = hb.Problem(name="own", **given)
    assert "no scales" in own.note_on_scales
    assert "no scales" in copy.deepcopy(own).note_on_scales
    assert hb.Problem(name="own", scales=hb.Scales(q=1.0, v=1.0), **given).note_on_scales == ""


class Cart(hb.System):
    def force(self, t, q, v):
        made = np.zeros(2)
        made[0] = jnp.sin(t)  # a habit from NumPy
        return made


def test_frequent_mistakes_lead_to_the_mend():
    start = {"name": "own", "t_span": (0, 1), "q0": [1, 0], "v0": [0, 0]}
    for call, hint in (
        (lambda: hb.Problem(system=Cart, **start), r"write system=Cart\(\)"),
        (
            lambda: hb.Problem(system=Cart(), **{**start, "v0": [0, 0, 0]}),
            "one entry for each of q0",
        ),
        (lambda: hb.solve(Cart(), rtol=1e-3), r"hb.Problem\(name="),
        (lambda: hb.solve(hb.Problem(system=Cart(), **start), rtol=1e-3), r"jnp.stack\(\[...\]\) or f = f.at\[0\]"),
    ):
        with pytest.raises((hb.ProblemError, TypeError), match=hint):
            call()
