"""The atlas of failures types every failure of a campaign."""

from __future__ import annotations

from hhtbench.campaign.store.rows import RunRow
from hhtbench.report.atlas import failure_atlas


def row(solver, status, rtol=1e-6, message="", error=None):
    errors = {} if error is None else {"errors": {"q": {"max_scaled": error}}}
    request = {"rtol": rtol, "atol": None, "step": None, "steps": None}
    return RunRow(key=solver, problem="p", solver=solver, request=request, status=status, message=message, metrics=errors)


def test_the_atlas_types_every_failure():
    rows = [
        row("ida(form='ggl')", "success", error=9e-4),
        row("ida(form='index2')", "success", error=2e-3),
        row("ida(form='ggl')", "newton_failed", 3e-6, "at t = 1"),
        row("hht", "unreliable", message="constraints: violated"),
        row("rattle", "declined"),
    ]
    found = failure_atlas(rows)
    assert found.runs == 4
    assert {(x.solver, x.form, x.accuracy, x.cause) for x in found.failures} == {
        ("ida", "index2", "rtol 1e-6", "silently wrong"),
        ("ida", "ggl", "rtol 1e-6", "newton_failed"),
        ("hht", "", "rtol 1e-6", "unreliable: constraints"),
    }
    assert found.table().rows[0][4].text == "silently wrong"
    assert "3 of 4 runs failed" in found.causes().note
