"""The study of stability: what its page and sentences say, and nothing that hangs."""

from __future__ import annotations

import json

import pytest

from hhtbench.conformance.entry import Kind, Outcome
from hhtbench.conformance.registry import FAMILIES, chosen
from hhtbench.conformance.stability import workers
from hhtbench.conformance.stability.page import allowed, counts, write_stability
from hhtbench.conformance.stability.study import Stability, letters, study_stability
from hhtbench.conformance.stability.workers import Batch, cells_of, outcome_in
from hhtbench.report import STABILITY
from hhtbench.runtime import processes
from tests.conformance.synthetic import SYNTHETIC


@pytest.mark.parametrize(
    ("name", "kind", "words", "overdue"),
    [("Sleeping", Kind.hung, "killed", 4.0), ("Dying", Kind.crashed, "ended: exit code 7", 100.0)],
)
def test_a_solver_that_hangs_or_dies_costs_one_cell(name, kind, words, overdue, monkeypatch):
    monkeypatch.setattr(workers, "MAX_OVERDUE", overdue)
    worker = processes.Worker()
    try:
        found = outcome_in(worker, Batch(f"{SYNTHETIC}:{name}", "stiffness", 0, (0,)), 0)
    finally:
        worker.end()
    assert found.kind is kind and words in found.message
    assert (found.x, found.line) == (100.0, "rtol 0.001")


def study():
    kinds = {
        "good": (Kind.right, Kind.right),
        "named": (Kind.named, Kind.named),
        "late": (Kind.budget, Kind.budget),
        "bad": (Kind.right, Kind.wrong),
        "shy": (Kind.declined, Kind.declined),
    }
    measured = [
        Outcome(id="stiffness", solver=solver, x=x, line="h = 1 s", kind=kind, share=0.5, seconds=x / 1e4)
        for solver, pair in kinds.items()
        for x, kind in zip((1e2, 1e4), pair, strict=True)
    ]
    axes = chosen(FAMILIES, ["stiffness"], "axis")
    return Stability(axes=axes, solvers=tuple(kinds), seed=0, measured=tuple(measured), seconds=1.0)


def test_a_line_says_what_is_allowed():
    found = study()
    assert allowed(found, found.axes[0])["rtol 1e-05"].startswith("slow motion 0.001; ")


def test_a_sentence_says_where_a_solver_is_safe():
    found = study()
    assert found.sentence("good").endswith("Safe on stiffness.")
    assert found.sentence("bad").endswith("Safe on no whole axis. Misleading on stiffness (1 of 2, at 10000).")
    assert found.sentence("named").startswith("named: of 2 cells 2 ended early and said so within 1 s.")
    for never in ("named", "late"):
        assert found.sentence(never).endswith(
            "Safe on no whole axis. Never misleading, but seldom arriving, on stiffness (0 right of 2)."
        )
    assert found.sentence("shy") == "shy can be asked none of these."
    assert letters(found.measured)["bad"] == {"h = 1 s": "rW"}
    assert [cell.text for cell in counts(found).rows[0][1:]] == ["2 of 2", "0 of 2", "0 of 2", "1 of 2", "-"]


def test_page_and_numbers_hold_every_cell(tmp_path):
    found = study()
    page = write_stability(found, tmp_path)
    assert page.name == STABILITY and "silently wrong" in page.read_text(encoding="utf-8")
    cells = json.loads(json.dumps(found.as_dict()))["cells"]
    assert [cell["kind"] for cell in cells] == [x.kind.label for x in found.measured]


def test_the_study_measures_every_small_cell_in_its_workers():
    found = study_stability(["redundant"], ["hht"], jobs=1, small=True)
    assert [x.kind for x in found.measured] == [Kind.right] * sum(cell.small for cell in cells_of("redundant", 0))
