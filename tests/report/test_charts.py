from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import plotly.graph_objects as go
import pytest

from hhtbench.report.chart import draw, on_axis
from hhtbench.report.charts import problem_charts
from hhtbench.report.colours import FAMILIES, solver_order, solver_styles
from hhtbench.report.drawings import Drawings
from hhtbench.report.frame import Chart, EdgeMark, Trace
from tests.analysis.laws import failed, law, run
from tests.report.drawings import figures_of
from tests.report.synthetic import SOLVERS


def _charts(rows):
    return {chart.id: chart for chart in problem_charts(rows)}


def _drawn(chart, *entries):
    styles = solver_styles(entries or {trace.entry for trace in chart.traces} | {m.entry for m in chart.marks})
    return go.Figure(draw(chart, styles))  # which refuses what plotly does not know


def _named(figure, name, symbol):
    return [trace for trace in figure.data if trace.name == name and trace.marker.symbol == symbol]


def test_failed_run_with_a_time_stands_above_all_errors_at_its_time_and_names_its_status():
    rows = [*law("ida", 50.0, 4), run("ida", 1e-7, None, 300, status="deadline", message="the budget is used up")]
    figure = _drawn(_charts(rows)["work-evaluations"])
    (mark,) = _named(figure, "ida", "hourglass-open")
    assert mark.x[0] == pytest.approx(300)
    assert mark.y[0] > max(max(trace.y) for trace in figure.data if trace.mode != "markers")
    assert math.log10(mark.y[0]) < figure.layout.yaxis.range[1]
    assert "deadline" in mark.text[0]
    assert "the budget is used up" in mark.text[0]


def test_run_that_is_not_believed_stands_hollow_at_its_own_time_and_error():
    rows = [*law("ida", 50.0, 4), run("ida", 2e-3, 0.5, 300, status="unreliable", message="g is 0.1")]
    chart = _charts(rows)["work-evaluations"]
    figure = _drawn(chart)
    (mark,) = _named(figure, "ida", "circle-open")
    assert (mark.x[0], mark.y[0]) == (pytest.approx(300), pytest.approx(0.5))
    assert "result rejected: g is 0.1" in mark.text[0]
    assert "error 0.5" in mark.text[0]
    assert 0.5 not in [y for trace in chart.traces for y in trace.y]
    assert "did not finish" not in str(figure.layout.annotations)


def test_run_that_is_not_believed_and_far_off_does_not_flatten_the_curves():
    rows = [*law("ida", 50.0, 4), run("ida", 2e-3, 1e9, 300, status="unreliable")]
    low, high = _drawn(_charts(rows)["work-evaluations"]).layout.yaxis.range
    assert high - low < 9


def test_multipliers_are_drawn_over_time_with_their_signs_and_the_largest_components():
    values = [[0.1, -5.0, 3.0, 1.0], [0.2, 5.0, -3.0, 1.0]]
    rows = [run("ida", 1e-4, 1e-4, 100, series={"multipliers": {"t": [0.0, 1.0], "lam": values, "mu": [[], []]}})]
    charts = _charts(rows)
    assert [trace.y for trace in charts["series-lam"].traces] == [(-5.0, 5.0), (3.0, -3.0), (1.0, 1.0)]
    assert "lam[1], lam[2] and lam[3]" in charts["series-lam"].caption
    assert "series-mu" not in charts
    low, high = _drawn(charts["series-lam"]).layout.yaxis.range
    assert low < -5.0 < 5.0 < high
    assert _drawn(charts["series-lam"]).layout.yaxis.type is None


def test_rows_without_multipliers_are_left_out_of_their_error_and_told():
    entry = {"max": 1e-3, "max_scaled": 1e-3}
    errors = {"points": 30, "q": entry, "v": entry, "lam": entry | {"unknown": 4}}
    rows = [run("hht", 1e-4, 1e-4, 100, metrics={"reached": 1.0, "errors": errors}), run("ida", 1e-4, 1e-4, 100)]
    caption = _charts(rows)["multipliers-lam"].caption
    assert caption.endswith("are left out, at most: hht (4 of 30).")


def test_invariants_are_drawn_over_time():
    series = {"drift": {"t": [0.0, 1.0], "invariants": {"momentum": [1e-9, 1e-7]}}}
    chart = _charts([run("ida", 1e-4, 1e-4, 100, series=series)])["invariant-momentum"]
    assert [trace.y for trace in chart.traces] == [(1e-9, 1e-7)]


def test_acceleration_level_is_drawn_where_it_was_measured_and_else_the_note_is_told():
    series = {"acceleration": {"t": [0.0, 1.0], "value": [1e-9, 1e-7]}}
    note = {"acceleration": None, "acceleration_note": "no multipliers of its own: zero by construction"}
    rows = [run("ida", 1e-4, 1e-4, 100, series=series), run("scipy", 1e-4, 1e-4, 100, series=series)]
    rows[0].metrics["drift"], rows[1].metrics["drift"] = {"acceleration": 1e-7}, note
    chart = _charts(rows)["drift-acceleration"]
    assert [trace.entry for trace in chart.traces] == ["ida"]
    assert "No series: scipy (no multipliers of its own: zero by construction)" in chart.caption


def test_caption_says_at_how_many_times_errors_were_compared():
    def caption(*points):
        rows = law("ida", 50.0, 4, settings=(1e-1, 1e-2, 1e-3, 1e-4))
        for row, count in zip(rows, points, strict=True):
            row.metrics["errors"]["points"] = count
        return _charts(rows)["work-time"].caption

    assert "compared at 1 time only" in caption(1, 1, 1, 1)
    assert "largest over 1 to 51 compared times" in caption(51, 1, 1, 1)


def test_declined_runs_of_a_solver_share_one_mark_at_the_right_edge():
    rows = [*law("ida", 50.0, 4), *(failed("cvode", setting, "declined", "no form") for setting in (1e-3, 1e-4))]
    for chart in ("work-time", "work-evaluations", "convergence-rtol"):
        figure = _drawn(_charts(rows)[chart])
        (mark,) = _named(figure, "cvode", "circle-open")
        assert mark.x[0] > max(max(trace.x) for trace in figure.data if trace.mode != "markers")
        assert math.log10(mark.x[0]) < figure.layout.xaxis.range[1]
        assert "declined: rtol 1e-03, rtol 1e-04" in mark.text[0]


def test_every_row_is_a_point_or_a_mark(rows):
    for problem in ("andrews", "knife_edge", "oscillator_chain(n=10)"):
        own = [row for row in rows if row.problem == problem]
        chart = _charts(own)["work-time"]
        inside = sum(len(trace.x) for trace in chart.traces)
        marked = sum(mark.text.count("rtol ") for mark in chart.marks)
        assert inside + marked == len(own)
        assert inside == sum(row.success for row in own)


def test_successful_run_without_a_count_of_evaluations_stands_at_the_right_at_its_error():
    rows = [*law("ida", 50.0, 4), run("diffrax", 1e-3, 1e-3, None)]
    (mark,) = [mark for mark in _charts(rows)["work-evaluations"].marks if mark.entry == "diffrax"]
    assert (mark.x, mark.y) == (None, 1e-3)


def test_run_without_any_error_stands_at_the_bottom():
    rows = [*law("ida", 50.0, 4), run("exact", 1e-3, 0.0, 100)]
    figure = _drawn(_charts(rows)["work-evaluations"])
    (mark,) = _named(figure, "exact", "triangle-down-open")
    assert math.log10(mark.y[0]) == pytest.approx(figure.layout.yaxis.range[0])


def test_marks_in_the_strip_do_not_hide_one_another():
    marks = tuple(EdgeMark(entry=f"s{i}", status="deadline", text="", x=1.0 + i / 1000) for i in range(6))
    texts = dict.fromkeys(("id", "group", "view", "title", "caption", "x_label", "y_label"), "")
    curve = Trace(entry="s0", x=(0.1, 100.0), y=(1.0, 1e-6), text=("", ""))
    chart = Chart(**texts, traces=(curve,), marks=marks)
    figure = _drawn(chart)
    heights = [math.log10(trace.y[0]) for trace in figure.data if trace.mode == "markers"]
    span = np.ptp(figure.layout.yaxis.range)
    assert min(abs(a - b) for a, b in combinations(heights, 2)) > 0.03 * span
    assert max(heights) < figure.layout.yaxis.range[1]


def test_spent_budget_far_to_the_right_does_not_flatten_the_curves():
    rows = [*law("ida", 50.0, 4), run("scipy", 1e-7, None, 1e9, status="deadline")]
    low, high = _drawn(_charts(rows)["work-evaluations"]).layout.xaxis.range
    assert high - low < 4


def test_ticks_stop_where_the_strip_of_failures_begins():
    rows = [*law("ida", 50.0, 4), run("scipy", 1e-7, None, 100, status="deadline")]
    figure = _drawn(_charts(rows)["work-evaluations"])
    assert max(figure.layout.yaxis.tickvals) <= 0.2 < 10 ** figure.layout.yaxis.range[1]


def test_limit_of_the_reference_is_drawn_where_errors_come_near_it():
    def annotations(digits):
        rows = law("ida", 50.0, 4)
        for row in rows:
            row.metrics["errors"]["digits"] = digits
        return [annotation.text for annotation in _drawn(_charts(rows)["work-time"]).layout.annotations]

    assert "error bar of the reference" in annotations(6)
    assert not annotations(12)


def test_drift_over_time_keeps_its_largest_value_when_thinned_and_zero_can_be_drawn():
    t = [float(i) for i in range(1000)]
    values = [0.0] * 1000
    values[777] = 1e-5
    rows = [run("ida", 1e-4, 1e-4, 100, series={"drift": {"t": t, "position": values}})]
    chart = _charts(rows)["drift-position"]
    (trace,) = chart.traces
    assert len(trace.x) < 60
    (place,) = [x for x, y in zip(trace.x, trace.y, strict=True) if y == 1e-5]
    assert place == pytest.approx(777.0, abs=1000 / 48)
    assert min(trace.y) == 1e-18
    assert "Zero is drawn at 1e-18" in chart.caption


def test_drift_of_a_motion_that_runs_backward_is_spread_over_its_times():
    t = [10.0 - i / 100 for i in range(1000)]
    chart = _charts([run("ida", 1e-4, 1e-4, 100, series={"drift": {"t": t, "position": [1e-9] * 1000}})])["drift-position"]
    (trace,) = chart.traces
    assert len(trace.x) > 30
    assert max(trace.x) - min(trace.x) > 9.0


def test_a_run_that_is_not_believed_and_has_no_drift_is_no_error():
    series = {"drift": {"t": [0.0, 0.5], "position": [None, None]}}
    _charts([run("ida", 1e-4, 1e-4, 100, series=series, status="unreliable")])


def test_drift_of_a_failed_run_is_drawn_as_far_as_it_came_with_its_status_at_the_end():
    series = {"drift": {"t": [0.0, 0.5], "position": [1e-9, 1e-8]}}
    rows = [run("ida", 1e-4, None, 100, status="newton_failed", series=series), failed("scipy", 1e-4, "crashed")]
    chart = _charts(rows)["drift-position"]
    assert [(mark.entry, mark.status, mark.x) for mark in chart.marks] == [("ida", "newton_failed", 0.5)]
    assert "No series: scipy (crashed)" in chart.caption


def test_caption_tells_the_slopes():
    rows = [run("hht", step, 3 * step**2, 1 / step, request={"step": step}, key=str(step)) for step in (0.1, 0.05, 0.025)]
    assert "with the spread: 2.00 \N{PLUS-MINUS SIGN} 0.00 (hht, steps=N)." in _charts(rows)["convergence-step"].caption


def test_caption_of_the_drift_tells_how_far_apart_the_errors_are():
    series = {"drift": {"t": [0.0, 0.5], "position": [1e-9, 1e-8]}}
    rows = [run("ida", 1e-4, 2e-4, 100, series=series), run("hht", 1e-4, 3e-3, 100, series=series)]
    assert "(they are from 2.0e-04 to 3.0e-03)" in _charts(rows)["drift-position"].caption


def test_families_have_their_colours_in_every_report_and_variants_differ():
    styles = solver_styles(SOLVERS)
    assert styles["hht(alpha=-0.1)"].colour == FAMILIES["hht"].lower()
    assert solver_styles(["hht(alpha=0)"])["hht(alpha=0)"].colour == FAMILIES["hht"].lower()
    assert len({style.colour for entry, style in styles.items() if entry.startswith("scipy")}) == 3
    looks = [(style.colour, style.dash) for style in styles.values()]
    assert len(set(looks)) == len(looks)


def test_order_of_solvers_is_by_family_and_strangers_come_last():
    order = solver_order(["zeta", "scipy(method=Radau)", "ida(form=ggl)", "hht(alpha=0)", "alpha", "hht(alpha=-0.1)"])
    assert order == ("hht(alpha=-0.1)", "hht(alpha=0)", "ida(form=ggl)", "scipy(method=Radau)", "alpha", "zeta")


def test_times_far_from_zero_stay_apart_and_no_number_spoils_a_page():
    drawings = Drawings()
    x = on_axis([2000.0123456, 2000.0623456, 2000.0124567])
    drawings.box({"data": [{"x": x, "name": "a name that is long"}], "layout": {"range": [1.0, np.inf]}})
    (figure,) = figures_of(drawings.scripts("")).values()
    assert figure["data"] == [{"x": [2000.01235, 2000.06235, 2000.01246], "name": "a name that is long"}]
    assert figure["layout"]["range"] == [1.0, None]
