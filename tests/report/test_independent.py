"""Every sentence of the summary, the decision table and its figures are true of the rows, whoever takes part."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from hhtbench import analysis
from hhtbench.analysis.fronts import campaign_of
from hhtbench.report.colours import solver_styles
from hhtbench.report.decisions import decisions
from hhtbench.report.overview import drift_views, profile_views
from hhtbench.report.summary import summary
from tests.report.independent import error, false_sentences
from tests.report.independent_figures import false_drifts, false_profiles
from tests.report.independent_table import false_lines
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


def newcomer(rows, source):
    """A solver that nobody knew: another's rows with errors, times and drifts changed."""
    model = source.choice(sorted({row.solver for row in rows}))
    own = source.choice(["newton", "hht(alpha=-0.2)", "minimal(alpha=-0.05, solver='hht')", "steady"])
    better, faster, steadier = (10 ** source.uniform(-2, 2) for _ in range(3))
    return [_changed(row, own, better, faster, steadier) for row in rows if row.solver == model]


def _changed(row, own, better, faster, steadier):
    metrics, timing = dict(row.metrics), dict(row.timing)
    if "errors" in metrics:
        entries = {k: {**v, "max_scaled": v["max_scaled"] * better} for k, v in metrics["errors"].items() if k in ("q", "v")}
        metrics["errors"] = {**metrics["errors"], **entries}
    if "drift" in metrics:
        levels = {k: v * steadier for k, v in metrics["drift"].items() if k in ("position", "velocity") and v is not None}
        metrics["drift"] = {**metrics["drift"], **levels}
    if timing.get("best_s"):
        timing["best_s"] *= faster
        timing["rounds_s"] = [value * faster for value in timing["rounds_s"]]
    return replace(row, solver=own, key=f"{row.key} {own}", metrics=metrics, timing=timing)


def drawn(seed):
    """Rows of a campaign with solvers that left or are new, with problems on which they were not run."""
    source = random.Random(seed)
    rows = with_rounds(campaign(seed), source)
    solvers = sorted({row.solver for row in rows})
    kept = set(source.sample(solvers, source.randint(3, len(solvers)))) | ({"hht(alpha=0)"} if seed % 3 else set())
    chosen = [row for row in rows if row.solver in kept]
    if seed % 2:
        chosen += newcomer(chosen, source)
    if seed % 5 == 0:
        chosen = [replace(row, request={**row.request, "held_out": row.problem == "andrews"}) for row in chosen]
    silent = {1: source.choice(["diffrax", "hht"]), 4: ""}.get(seed % 6)  # "": all, and HHT is not among them
    if silent is not None:
        chosen = [replace(row, counters={}) if silent in row.solver else row for row in chosen]
        chosen = [row for row in chosen if silent or "hht" not in row.solver]
    lost = {(row.solver, row.problem) for row in chosen if source.random() < 0.03} if seed % 4 == 3 else set()
    chosen = [replace(row, **FAILED) if seed % 2 and source.random() < 0.03 else row for row in chosen]
    chosen = asked_for(chosen, source) if seed % 4 in (1, 2) else chosen
    for row in source.sample(chosen, 9):  # where the functions of the problem could not be called
        if "system" in row.metrics:
            row.metrics["system"] = {**row.metrics["system"], "m": None, "p": None}
    return [row for row in chosen if (row.solver, row.problem) not in lost]


def asked_for(rows, source):
    """The same as a campaign asked for them, with budgets that differ; some pairs failed, others were stopped on the way."""
    found, seconds = [], source.choice([2e-3, 20.0])  # what fails costs little or much beside what does not
    for pair in dict.fromkeys((row.problem, row.solver) for row in rows):
        own = [row for row in rows if (row.problem, row.solver) == pair]
        rules = {"accuracies": [1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6], "max_seconds": seconds, "refinements": 5}
        rules["pair_seconds"] = seconds * source.choice([1.5, 3.0])
        changes = FAILED if source.random() < 0.2 else {}
        own = [replace(row, request={**row.request, "max_seconds": seconds, "rules": rules}, **changes) for row in own]
        stopped = seconds > 1.0 and all(row.success for row in own) and source.random() < 0.2
        found += own[: -2 if stopped else None]
    return found


def tables_of(rows):
    return decisions(rows, analysis.kinds(rows), campaign_of(rows))


@pytest.mark.parametrize("seed", range(12))
def test_what_is_said_and_shown_is_true_whoever_takes_part(seed):
    rows = drawn(seed)
    assert false_sentences(" ".join(summary(rows)), rows) == []
    tables = tables_of(rows)
    assert false_lines(tables, rows) == []
    styles = solver_styles(analysis.entries(rows))
    assert [w for view in drift_views(rows, styles) for w in false_drifts(view, rows, view.name)] == []
    curves = [view for view in profile_views(rows, styles, []) if view.name in ("time", "evaluations")]
    assert [w for view in curves for w in false_profiles(view, rows, view.name)] == []


def test_a_false_number_is_found():
    rows = with_rounds(campaign(1), random.Random(1))
    text = " ".join(summary(rows))
    assert false_sentences(text, rows) == []
    worst = max((row for row in rows if error(row) and row.solver.startswith("hht")), key=error)
    worst.metrics["drift"]["position"] = 0.5
    without = [row for row in rows if row.solver != "ida(form='ggl')"]
    assert len(false_sentences(text, without)) > 3
    assert false_sentences(text.replace("loses 1", "loses 9"), rows)


def test_a_false_cell_is_found_whatever_it_says():
    rows = drawn(2)
    tables = tables_of(rows)
    lines = tables["time", None].rows
    for column in range(len(lines[0])):
        told = [line[column] for line in lines]
        longest = max(told, key=lambda cell: len(cell.detail + cell.text))
        where = told.index(longest)
        spoilt = [longest._replace(text=f"{longest.text}0"), longest._replace(detail=f"{longest.detail}0")]
        spoilt += [longest._replace(detail=f"at most {longest.detail}"), longest._replace(tone="bad")]
        for cell in spoilt:
            line = (*lines[where][:column], cell, *lines[where][column + 1 :])
            table = replace(tables["time", None], rows=(*lines[:where], line, *lines[where + 1 :]))
            assert len(false_lines({("time", None): table}, rows)) == 1
    assert false_lines({("time", None): tables["time", None]}, [row for row in rows if "ida" not in row.solver])
