from __future__ import annotations

import json
import shlex

import click
import numpy as np
import pytest
from click.testing import CliRunner

from hhtbench.advice import trading
from hhtbench.campaign.analysis.fronts import MEASURES
from hhtbench.cli.main import main
from hhtbench.conformance.validation import plan as validation
from hhtbench.lowering.description import Description, Statement
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.evidence import Evidence, Row
from hhtbench.solution.result import Solution, Status


@pytest.fixture
def run():
    runner = CliRunner()
    return lambda *words: runner.invoke(main, list(words))


def _evidence(passed):
    rows = (Row(id="start/g", claim="the start is consistent", measured=1e-3, bound="<= 1e-9", passed=passed),)
    return Evidence(title="check of fall", rows=rows)


def test_list_shows_names_and_first_docstring_lines(acme, run):
    result = run("list")
    assert result.exit_code == 0
    line = next(line for line in result.output.splitlines() if "acme_fall" in line)
    assert line.split(maxsplit=1)[1] == "A weight that falls."
    assert [word for word in ("problems", "solvers", "verifications") if f"{word}\n" not in result.output] == []


def commands():
    """Every command, those of groups too, by its words."""
    for name, command in main.commands.items():
        yield name, command
        for word, inner in getattr(command, "commands", {}).items():
            yield f"{name} {word}", inner


@pytest.mark.parametrize(("words", "command"), list(commands()), ids=lambda value: value if isinstance(value, str) else "")
def test_the_help_of_every_command_ends_with_an_example_that_it_can_read(words, command):
    example = shlex.split(command.help.partition("For example: hhtbench ")[2])
    assert example[: len(words.split())] == words.split(), "no example, or one of another command"
    reader, rest = main.commands[example[0]], example[1:]
    if isinstance(reader, click.Group):
        reader, rest = reader.commands[rest[0]], rest[1:]
    assert reader.make_context(reader.name, rest).params


def test_a_solver_behind_the_problem_is_answered_with_its_option(run):
    result = run("solve", "acme_fall", "hht")
    assert result.exit_code == 2
    assert "a solver is given by --solver" in result.stderr


def test_every_command_writes_json():
    without = [words for words, command in commands() if not isinstance(command, click.Group) and not _has_json(command)]
    assert without == []


def _has_json(command):
    return any("--json" in parameter.opts for parameter in command.params)


def test_the_defaults_that_the_help_names_are_those_of_the_functions():
    """The help names them itself, because the functions' modules are heavy."""
    assert _default("trade", "seconds") == trading.SECONDS
    assert _default("validate", "max_seconds") == validation.MAX_SECONDS
    for name in ("trade", "select"):
        assert next(p for p in _parameters(name) if p.name == "on").metavar == f"[{'|'.join(MEASURES)}]"


def _parameters(name):
    return main.commands[name].params


def _default(name, parameter):
    return next(p for p in _parameters(name) if p.name == parameter).default


def test_solve_prints_status_counters_and_end_state_and_writes_arrays(acme, run, tmp_path):
    file = tmp_path / "run.npz"
    result = run("solve", "acme_fall(height=2)", "--solver", "acme_still", "--step", "0.1", "--output", str(file))
    assert result.exit_code == 0, result.output
    assert "status: success: stood still" in result.output
    assert "newton_iterations: not reported" in result.output
    assert "at t = 1 s" in result.output
    arrays = np.load(file)
    assert arrays["q"].tolist() == [[2.0], [2.0]]
    assert Solution.load(file).status is Status.success


def test_solve_prints_the_error_where_the_end_is_known(mechanism, acme, run):
    with (mechanism / "my_mechanism.py").open("a") as file:
        file.write(
            "from dataclasses import replace\n"
            "from hhtbench.protocol.problem import Motion\n"
            "from hhtbench.protocol.scales import Scales\n"
            "known = replace(finished, scales=Scales(q=10.0), exact=lambda t: Motion([1.5], [0.0], [], []))\n"
            "table = replace(finished, reference={'t': [0.0, 1.0], 'q': [[1.0], [1.25]], 'digits': 9})\n"
        )
    exact = run("solve", "my_mechanism.py:known", "--solver", "acme_still", "--steps", "3").output
    assert "against the exact solution" in exact
    assert "q 5.000e-01 5.000e-02" in " ".join(exact.split())
    assert (
        "against the reference (9 digits)"
        in run("solve", "my_mechanism.py:table", "--solver", "acme_still", "--steps", "3").output
    )


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["solve", "acme_fall", "--solver", "acme_still", "--steps", "3"], 0),
        (["solve", "acme_fall", "--solver", "acme_still(alpha=-1)", "--steps", "3"], 1),
        (["solve", "acme_fall", "--solver", "acme_still", "--rtol", "1e-3"], 1),
        (["verify", "acme_good"], 0),
        (["verify", "acme_bad"], 1),
        (["verify", "acme_ugly"], 2),
        (["solve", "acme_fal"], 2),
        (["solve", "acme_fall(", "--step", "0.1"], 2),
        (["solve", "acme_fall", "--solver", "acme_still", "--step", "-1"], 2),
        (["solve", "acme_fall", "--solver", "acme_still", "--step", "1", "--rtol", "1e-3"], 2),
        (["solve", "acme_fall", "--step", "abc"], 2),
        (["solve", "acme_fall", "--solver", "acme_still", "--step", "1", "--output", "not/there/run.npz"], 2),
        (["describe", "nothing.py:problem"], 2),
        (["check", "acme_nonsense"], 2),
        (["unknown"], 2),
    ],
)
def test_exit_code_says_well_failed_or_wrong_use(words, code, acme, run):
    result = run(*words)
    assert result.exit_code == code, result.output
    assert "Traceback" not in result.output


def test_wrong_use_is_one_message_and_traceback_is_on_request(acme, run):
    result = run("solve", "acme_fal")
    assert result.stderr.startswith("Error: there is no problem named 'acme_fal'")
    assert result.stdout == ""
    assert isinstance(run("-v", "solve", "acme_fal").exception, ProblemError)


def test_declined_problem_is_reported_with_its_reason(acme, run):
    result = run("solve", "acme_fall", "--solver", "acme_still", "--rtol", "1e-3")
    assert "declined: it takes given steps only; give step=h" in result.output


def test_warning_is_one_line_on_stderr(acme, run):
    result = run("solve", "acme_fall", "--solver", "acme_still", "--rtol", "5")
    assert result.stderr == "UserWarning: rtol=5 is larger than 0.1: no digit will be right.\n"


@pytest.mark.parametrize(("passed", "code"), [(True, 0), (False, 1)])
def test_check_prints_the_rows_writes_them_and_fails_when_one_fails(passed, code, acme, run, tmp_path, monkeypatch):
    monkeypatch.setattr("hhtbench.checks.problem.check", lambda problem: _evidence(passed))
    file = tmp_path / "check.json"
    result = run("check", "acme_fall", "--json", str(file))
    assert result.exit_code == code
    assert "the start is consistent" in result.output
    assert result.output.rstrip().splitlines()[-1].startswith("check of fall: ")
    assert json.loads(file.read_text())["passed"] is passed


def test_describe_prints_the_description(acme, run, monkeypatch):
    told = Description(title="describes fall", statements=(Statement("declared", "force", "a weight"),))
    monkeypatch.setattr("hhtbench.lowering.description.describe", lambda problem: told if problem.name == "fall" else None)
    assert run("describe", "acme_fall").output == f"{told}\n"


def test_verify_writes_report_and_rows_and_ends_with_the_summary(acme, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run("verify", "acme_good", "--json", "rows.json", "--report", "out/latest")
    assert result.output.rstrip().splitlines()[-1] == "stands: 1 of 1 claims hold"
    assert sorted(p.name for p in (tmp_path / "out/latest").iterdir()) == ["convergence.html", "evidence.json", "report.md"]
    assert json.loads((tmp_path / "rows.json").read_text())["passed"] is True
    assert "hhtbench verify acme_good --report out/latest" in (tmp_path / "out/latest/report.md").read_text()


def test_report_shows_no_path_of_this_machine(acme, run, tmp_path):
    run("verify", "acme_good", "--report", str(tmp_path / "elsewhere"))
    assert str(tmp_path) not in (tmp_path / "elsewhere/report.md").read_text()


def test_progress_goes_to_stderr_and_the_result_to_stdout(acme, run):
    result = run("verify", "acme_good")
    assert result.stderr == "claims: 1 of 2\n"
    assert "claims: 1" not in result.stdout


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("list",), lambda told: "acme_fall" in told["problem"] and "acme_still" in told["solver"]),
        (("describe", "acme_fall"), lambda told: any(row["subject"] == "force" for row in told["statements"])),
        (
            ("solve", "acme_fall(height=2)", "--solver", "acme_still", "--step", "0.1"),
            lambda told: told["status"] == "success" and told["q"] == [[2.0], [2.0]] and told["counters"]["provenance"],
        ),
    ],
)
def test_what_a_command_prints_is_there_as_json(acme, run, tmp_path, words, found):
    file = tmp_path / "found.json"
    result = run(*words, "--json", str(file))
    assert result.exit_code == 0, result.output
    assert found(json.loads(file.read_text()))
    assert run(*words, "--json", str(tmp_path / "nowhere" / "found.json")).exit_code == 2


def test_diagnose_names_the_cause_of_a_failure_and_checks_a_success(run):
    """One step over the whole interval fails; the pendulum of the paper is right at 1e-4."""
    failed = run("diagnose", "jay_negrut_pendulum", "--steps", "1")
    assert failed.exit_code == 1
    assert "cause: Forces carry a vibration" in failed.output
    right = run("diagnose", "jay_negrut_pendulum", "--rtol", "1e-4")
    assert right.exit_code == 0
    assert "nothing speaks against the solution" in right.output
