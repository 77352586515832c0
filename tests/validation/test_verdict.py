"""Verdicts of the cross-solver validation, from rows made by hand; and one run of the command."""

import pytest
from click.testing import CliRunner

from hhtbench.campaign.reference.plan import load_plan, registered_folder, validated_spec
from hhtbench.campaign.store import RunRow
from hhtbench.catalogue.registry import load_problem
from hhtbench.cli.main import main
from hhtbench.conformance.validation.table import solvability
from hhtbench.conformance.validation.verdict import Kind, evidence_rows, judge, short


def row(solver="ida(form='ggl')", error=1e-9, status="success", rtol=1e-8, digits=None, problem="p"):
    errors = {"q": {"max_scaled": error}, "v": {"max_scaled": (error or 0.0) / 2}, "digits": digits}
    request = {"rtol": rtol, "step": None, "steps": None}
    metrics = {} if error is None else {"errors": errors}
    counters = {"residual_evaluations": 1234}
    return RunRow(
        key=f"{solver}{rtol}",
        problem=problem,
        solver=solver,
        request=request,
        status=status,
        message="why",
        metrics=metrics,
        counters=counters,
    )


@pytest.mark.parametrize(
    ("rows", "kind"),
    [
        ([row(error=1e-4), row(error=1e-8, rtol=1e-10)], Kind.agrees),
        ([row(error=1e-3), row(error=1e-5, rtol=1e-10)], Kind.converges),
        ([row(error=1e-3)], Kind.disagrees),
        ([row(error=1e-3, digits=4)], Kind.disagrees),
        ([row(error=1e-3, digits=3)], Kind.agrees),  # the reference itself is no better
        ([row(error=None)], Kind.unknown),
        ([row(error=None, status="deadline"), row(error=None, status="newton_failed")], Kind.failed),
        ([row(error=None, status="declined")], Kind.declined),
        ([row(error=1e-4), row(error=None, status="deadline", rtol=1e-10)], Kind.unfinished),
        ([row(error=1e-2), row(error=None, status="deadline", rtol=1e-10)], Kind.disagrees),  # too far to be excused
        ([row(error=1e-4), row(error=None, status="newton_failed", rtol=1e-10)], Kind.disagrees),  # not a matter of time
        ([row(error=None, status="deadline"), row(error=1e-4, rtol=1e-10)], Kind.disagrees),  # the tightest did finish
        ([row(error=1e-5), row(error=1e-1, rtol=1e-10)], Kind.disagrees),  # it grew
        ([row(error=4.0, rtol=1e-10), row(error=10.0)], Kind.disagrees),  # far from everything, in any order
        ([row(error=0.5, rtol=1e-10), row(error=1e-9)], Kind.disagrees),  # the tighter run is what counts
        ([row(error=1e-3), row(error=5e-4, rtol=1e-10)], Kind.disagrees),  # hardly falls
        ([row("hht", 5e-5)], Kind.agrees),
        ([row("hht", 5e-4)], Kind.disagrees),
    ],
)
def test_a_pair_is_judged_by_its_best_run(rows, kind):
    (verdict,) = judge(rows)
    assert verdict.kind is kind


def pairs(count, error=1e-9):
    return [row(f"scipy(method='m{i}')", error) for i in range(count)] + [row("hht", 1e-5)]


def test_six_pairs_must_agree_unless_there_is_a_reason():
    verdict = {r.id: r.passed for r in evidence_rows(judge(pairs(6)), {})}
    assert verdict == {"p/agree": True, "p/pairs": True, "p/hht": True}
    assert {r.id: r.passed for r in evidence_rows(judge(pairs(5)), {})}["p/pairs"] is False
    excused = {r.id: r for r in evidence_rows(judge(pairs(5)), {"p": "it is singular"})}
    assert excused["p/pairs"].passed
    assert "it is singular" in excused["p/pairs"].measured


def test_one_that_disagrees_fails_the_problem_whatever_the_reason():
    rows = evidence_rows(judge([*pairs(7), row("ida(form='index1')", 1e-2)]), {"p": "it is singular"})
    wrong = next(r for r in rows if r.id == "p/agree")
    assert wrong.passed is False
    assert "ida" in str(wrong.measured)


def test_the_table_shows_digits_statuses_and_reasons():
    rows = [
        row(error=3e-9),
        row("cvode(method='bdf', form='ode')", None, "deadline"),
        row("hht", 1.6e-4),
        row("hht", 9e-4, rtol=1.0),
    ]
    text = solvability(judge(rows), "hhtbench validate p")
    assert short("cvode(method='bdf', form='ode')") == "cvode bdf"
    for part in ("| p ", "8.5", "deadline", "(3.8)", "1,234", "cvode bdf, deadline: why: p"):
        assert part in text, part


MECHANISM = """
import jax.numpy as jnp, numpy as np
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.system import System
class Spring(System):
    def force(self, t, q, v):
        return -4.0 * q
def problem(wrong=0.0):
    exact = lambda t: Motion(np.array([np.cos(2*t)*(1+wrong*t)]), np.array([-2*np.sin(2*t)]), np.zeros(0), np.zeros(0))
    return Problem(name="spring", system=Spring(), t_span=(0.0, 1.0), q0=[1.0], v0=[0.0], exact=exact)
"""


@pytest.mark.parametrize(("wrong", "code"), [(0.0, 0), (0.01, 1)])
def test_the_command_leaves_with_one_where_a_solver_disagrees(tmp_path, monkeypatch, wrong, code):
    (tmp_path / "spring.py").write_text(MECHANISM)
    monkeypatch.chdir(tmp_path)
    six = [f"scipy(method={method})" for method in ("DOP853", "Radau", "LSODA", "BDF")]
    six += ["cvode(method=bdf)", "cvode(method=adams)"]
    monkeypatch.setattr("hhtbench.conformance.validation.plan.PAIRS", tuple(six))
    monkeypatch.setattr("hhtbench.conformance.validation.plan.STEPS", (2000,))
    result = CliRunner().invoke(main, ["validate", f"spring.py:problem(wrong={wrong})", "--jobs", "1", "--out", "table.md"])
    assert result.exit_code == code, result.output
    assert "projected DOP853" not in (tmp_path / "table.md").read_text()


def test_who_made_the_reference_does_not_count_among_those_that_agree():
    makers = frozenset({"scipy(method='m0')"})
    assert {r.id: r.passed for r in evidence_rows(judge(pairs(6)), {}, makers)}["p/pairs"] is False


def test_wrong_multipliers_disagree():
    wrong = row()
    wrong.metrics["errors"]["lam"] = {"max_scaled": 1.0}
    assert judge([wrong])[0].kind is Kind.disagrees


def test_all_takes_the_span_that_the_reference_plan_names():
    plan = load_plan(registered_folder() / "plan.toml")
    assert validated_spec("four_bars", plan) == "four_bars(n_windows=1, t_end=0.5)"
    assert validated_spec("andrews", plan) == "andrews"
    for entry in plan.values():
        if entry.validate:
            problem = load_problem(entry.validate)
            assert problem.reference is not None, entry.validate
            assert problem.reference["t"][-1] == problem.t_span[1], entry.validate
