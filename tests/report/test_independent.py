"""Every sentence of the summary, the decision table and its figures are true of the rows, whoever takes part."""

from __future__ import annotations

import random
from dataclasses import replace
from itertools import product

import pytest

from hhtbench.campaign import analysis
from hhtbench.report.summary import summary
from tests.report.independent import Truth, error, false_sentences
from tests.report.synthetic import rows as campaign

FAILED = {"status": "crashed", "metrics": {}, "timing": {}, "counters": {}}


def with_rounds(rows, source):
    """Timed in two rounds that differ by some per cent."""
    for row in rows:
        best = row.timing.get("best_s")
        if best and source.random() < 0.05:  # its timed solves have failed
            row.timing.update(best_s=None, median_s=None, repeats=0)
        elif best:
            row.timing["rounds_s"] = [best, best * (1 + abs(source.gauss(0.0, 0.02)))]
    return rows


def drawn(seed):
    """Rows of a campaign with solvers that left or are new, with problems on which they were not run."""
    source = random.Random(seed)
    rows = with_rounds(campaign(seed), source)
    solvers = sorted({row.solver for row in rows})
    kept = set(source.sample(solvers, source.randint(3, len(solvers)))) | ({"hht(alpha=0)"} if seed % 3 else set())
    chosen = [row for row in rows if row.solver in kept]
    if seed % 5 == 0:
        chosen = [replace(row, request={**row.request, "held_out": row.problem == "andrews"}) for row in chosen]
    silent = {1: source.choice(["diffrax", "hht"]), 4: ""}.get(seed % 6)  # "": all, and HHT is not among them
    if silent is not None:
        chosen = [replace(row, counters={}) if silent in row.solver else row for row in chosen]
        chosen = [row for row in chosen if silent or "hht" not in row.solver]
    lost = {(row.solver, row.problem) for row in chosen if source.random() < 0.03} if seed % 4 == 3 else set()
    chosen = [replace(row, **FAILED) if seed % 2 and source.random() < 0.03 else row for row in chosen]
    for row in source.sample(chosen, 9):  # where the functions of the problem could not be called
        if "system" in row.metrics:
            row.metrics["system"] = {**row.metrics["system"], "m": None, "p": None}
    return [row for row in chosen if (row.solver, row.problem) not in lost]


@pytest.mark.parametrize("seed", range(12))
def test_what_is_said_and_shown_is_true_whoever_takes_part(seed):
    rows = drawn(seed)
    truth, kinds = Truth(rows), analysis.kinds(rows)
    assert false_sentences(" ".join(summary(rows)), rows) == []
    for measure, bound in product(("time", "evaluations"), (None, 1e-6, 1e-10)):
        for choice in analysis.decide(rows, kinds, measure, (1e-2, 1e-4, 1e-6), bound):
            told = [(place.entry, len(place.costs), pytest.approx(place.mean)) for place in choice.places]
            assert truth.order(kinds[choice.kind], choice.target, measure, bound) == told


def test_a_false_number_is_found():
    rows = with_rounds(campaign(1), random.Random(1))
    text = " ".join(summary(rows))
    assert false_sentences(text, rows) == []
    worst = max((row for row in rows if error(row) and row.solver.startswith("hht")), key=error)
    worst.metrics["drift"]["position"] = 0.5
    without = [row for row in rows if row.solver != "ida(form='ggl')"]
    assert len(false_sentences(text, without)) > 3
    assert false_sentences(text.replace("loses 1", "loses 9"), rows)
