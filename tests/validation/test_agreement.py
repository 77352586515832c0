"""Where nothing is known of a solution the solvers judge one another."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

import hhtbench as hb
from hhtbench.campaign.store import RunRow
from hhtbench.cli.main import main
from hhtbench.conformance.validation.agreement import agreement_rows, compare_rows
from hhtbench.conformance.validation.verdict import Kind, judge

TIMES = np.linspace(0.0, 1.0, 5)


class Free(hb.System):
    def force(self, t, q, v):
        return 0 * q


PROBLEM = hb.Problem(name="p", system=Free(), t_span=(0.0, 1.0), q0=[1.0], v0=[1.0])


def row(solver, off, rtol=1e-10, status="success"):
    states = {"t": TIMES, "q": (1.0 + TIMES * (1 + off))[:, None], "v": np.full((5, 1), 1.0 + off)}
    request = {"rtol": rtol, "step": None, "steps": None}
    series = {"states": {name: values.tolist() for name, values in states.items()}} if status == "success" else {}
    return RunRow(
        key=f"{solver}{rtol}", problem="p", solver=solver, request=request, status=status, message="why", series=series
    )


def judged(*rows):
    compared = compare_rows("p", PROBLEM, rows)
    verdicts = judge(compared.rows)
    return compared, {v.solver: v.kind for v in verdicts}, {r.id: r for r in agreement_rows(compared, verdicts)}


def test_two_libraries_that_agree_suffice_and_their_spread_estimates_the_error():
    compared, kinds, claims = judged(row("ida", 0.0), row("cvode", 1e-8), row("scipy", 3e-8))
    assert set(kinds.values()) == {Kind.agrees}
    assert all(claim.passed in (True, None) for claim in claims.values())
    assert claims["p/spread"].measured == pytest.approx(3e-8, rel=0.1)
    assert compared.agreement.names == ("ida", "cvode", "scipy")
    assert "no reference: judged by agreement" in claims["p/agree"].claim


def test_one_that_stands_alone_is_named():
    _, kinds, claims = judged(row("ida", 0.0), row("cvode", 1e-8), row("scipy", 1e-2))
    assert kinds == {"ida": Kind.agrees, "cvode": Kind.agrees, "scipy": Kind.disagrees}
    assert claims["p/agree"].passed is False
    assert "scipy 9.9e-03" in claims["p/agree"].measured


def test_forms_of_one_library_are_not_two_witnesses():
    _, _, claims = judged(row("ida(form='ggl')", 0.0), row("ida(form='index1')", 1e-9))
    assert claims["p/families"].passed is False


def test_two_that_contradict_one_another_prove_nothing():
    _, kinds, claims = judged(row("ida", 0.0), row("cvode", 0.1))
    assert Kind.agrees not in kinds.values()
    assert claims["p/agree"].passed is False
    assert claims["p/families"].passed is False


def test_one_alone_has_nobody_to_agree_with():
    _, kinds, claims = judged(row("ida", 0.0), row("cvode", 0.0, status="newton_failed"))
    assert kinds == {"ida": Kind.unknown, "cvode": Kind.failed}
    assert claims["p/families"].passed is False


def test_the_tightest_run_counts_and_a_looser_one_that_falls_converges():
    _, kinds, _ = judged(row("ida", 0.0), row("cvode", 0.0), row("scipy", 1e-4, rtol=1e-8), row("scipy", 1e-5))
    assert kinds["scipy"] is Kind.converges


MECHANISM = """
import jax.numpy as jnp
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import System
class Rod(System):
    def force(self, t, q, v):
        return jnp.array([0.0, -9.81]) - 0.1 * v
    def constraint(self, t, q):
        return (q[:1] ** 2 + q[1:] ** 2 - 1.0) / 2
problem = Problem(name="rod", system=Rod(), t_span=(0.0, 1.0), q0=[1.0, 0.0], v0=[0.0, 5.0])
"""
LIARS = """
from dataclasses import replace
import hhtbench as hb
class Straight:
    name = "straight"
    of = hb.load_solver("projected")
    def accepts(self, problem, request):
        return self.of.accepts(problem, request)
    def solve(self, problem, request):
        found = self.of.solve(problem, request)
        return replace(found, q=problem.q0 + found.t[:, None] * problem.v0, v=0 * found.v + problem.v0)
class Beside(Straight):
    name = "beside"
    def solve(self, problem, request):
        return self.of.solve(replace(problem, v0=problem.v0 * (1 + 9e-7)), request)
"""


@pytest.mark.parametrize(("more", "code"), [(("liar.py:Straight",), 0), (("liar.py:Beside",), 1)])
def test_ones_own_problem_without_reference_is_judged_by_agreement(tmp_path, monkeypatch, more, code):
    (tmp_path / "rod.py").write_text(MECHANISM)
    (tmp_path / "liar.py").write_text(LIARS)
    monkeypatch.chdir(tmp_path)
    pairs = ("ida(form=index1)", "cvode(method=bdf)", "scipy(method=DOP853)", "projected(method=DOP853)", *more)
    monkeypatch.setattr("hhtbench.conformance.validation.plan.PAIRS", pairs)
    monkeypatch.setattr("hhtbench.conformance.validation.plan.STEPS", (2000,))
    result = CliRunner().invoke(main, ["validate", "rod.py:problem", "--jobs", "1", "--out", "table.md"])
    assert result.exit_code == code, result.output
    assert "no reference: judged by agreement" in result.output
    text = (tmp_path / "table.md").read_text()
    assert "## rod.py:problem: who agrees with whom" in text
    assert "rattle" in text
    if code:  # a motion from a start that is off by as little as is believed: only the others show it
        assert "Beside 1" in result.output
    elif more:  # its rows are not believed, so that it takes no part
        assert "Straight, unreliable: constraints" in text
