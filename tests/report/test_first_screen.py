from __future__ import annotations

import re
from dataclasses import replace

import pytest

from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.fronts import Campaign
from hhtbench.campaign.analysis.kinds import SMOOTH, VIBRATIONS, Kind
from hhtbench.report import write_comparison
from hhtbench.report.atlas import DECLINED, SILENT, failure_atlas
from hhtbench.report.chart import draw
from hhtbench.report.charts import problem_charts
from hhtbench.report.colours import solver_styles
from hhtbench.report.decisions import choices_of, decisions
from hhtbench.report.overview import _label_places, drift_views, profile_views
from hhtbench.report.recommendations import recommendations
from hhtbench.report.rules import campaign_line
from hhtbench.report.runs import failures_by_reason
from hhtbench.report.words import AT_MOST, NOTHING, short, times, work
from tests.analysis.laws import failed, ladder, law, run
from tests.report.conftest import COMMAND

KIND = Kind(constraints="position constraints", forces=SMOOTH)
WHOLE = Campaign(level=1.5, targets=(1e-2, 1e-3, 1e-4))


COLUMNS = (
    *("kind", "problems", "error", "cheapest", "cost", "second", "factor", "HHT", "place", "HHT's factor", "reaches", "why"),
    *("steady", "steady's factor"),
)


def table_of(rows, measure="time", bound=None, problems=("pendulum",), held_out=()):
    return decisions(choices_of(rows, {KIND: problems}, WHOLE), WHOLE, held_out)[measure, bound]


def lines_of(rows, *asked, **changes):
    """Cells of the table's lines by their columns, each as one text."""
    table = table_of(rows, *asked, **changes)
    return [
        dict(zip(COLUMNS, (" | ".join(filter(None, (cell.text, cell.detail))) for cell in line), strict=False))
        for line in table.rows
    ]


def test_table_names_the_cheapest_with_its_cost_the_second_with_its_factor_and_the_place_of_hht():
    rows = [*law("hht(alpha=-0.1)", 400.0, 2), *law("ida(form=ggl)", 100.0, 2), *law("scipy(method=DOP853)", 200.0, 2)]
    coarse, fine = lines_of(rows)
    assert [line["error"] for line in (coarse, fine)] == ["1e-02", "1e-04"]  # 1e-3 is left to the tables below
    assert [coarse[name] for name in ("cheapest", "cost", "second", "factor")] == [
        *("ida(ggl)", "10 ms", "scipy(DOP853)", times(2)),
    ]
    own = [coarse[name] for name in ("HHT", "place", "HHT's factor", "reaches", "why")]
    assert own == ["hht(-0.1)", "3 of 3", times(4), "1 of 1", ""]
    assert coarse["problems"] == "1"


def test_the_cheapest_that_keeps_the_drift_only_with_tighter_settings_costs_more():
    rows = [*law("ida", 100.0, 2, drift=1e-5), run("ida", 1e-8, 1e-8, 4e6)]
    rows[-1].metrics["drift"] = {"position": 1e-12, "velocity": 1e-12}
    coarse, fine = lines_of(rows)
    cost = 4e6 / 10_000.0  # of the tight run over that at an error of 1e-4
    assert (fine["steady"], fine["steady's factor"]) == ("ida", f"{AT_MOST} {times(cost)}")
    assert "It keeps drift below 1e-10 with tighter settings, at 400 times the cost." in said(rows)
    assert coarse["steady"] == "ida"


def test_held_out_problems_are_counted():
    rows = two_problems("hht", 100.0, 100.0)
    assert [line["problems"] for line in lines_of(rows, problems=BOTH, held_out={"andrews"})] == ["2 | 1 held out"] * 2


def test_times_that_differ_by_less_than_repeats_of_one_solve_are_called_equal_and_evaluations_are_not():
    rows = [*law("hht", 140.0, 2), *law("ida", 100.0, 2)]
    assert lines_of(rows)[0]["factor"] == f"{times(1.4)} | equal within noise"
    assert lines_of(rows, "evaluations")[0]["factor"] == times(1.4)


def test_table_names_the_cheapest_that_keeps_the_drift_and_its_factor():
    rows = [*law("ida", 100.0, 2, drift=1e-5), *law("hht", 300.0, 2, drift=1e-14), *law("rattle", 400.0, 2, drift=1e-14)]
    line = lines_of(rows)[0]
    assert (line["cheapest"], line["steady"], line["steady's factor"]) == ("ida", "hht | and 1 more", times(3))
    assert lines_of(law("ida", 100.0, 2, drift=1e-5))[0]["steady"] == "nobody reaches it"
    assert lines_of(law("ida", 100.0, 2, drift=1e-15))[0]["steady's factor"] == times(1)
    free = law("ida", 100.0, 2)
    for row in free:
        row.metrics["drift"] = {}
    assert lines_of(free)[0]["steady"] == "no drift"


BOTH = ("pendulum", "andrews")


def two_problems(solver, first, second):
    return [*law(solver, first, 2), *law(solver, second, 2, problem="andrews")]


def test_who_reaches_less_is_not_the_cheapest_and_his_factor_is_that_on_problems_both_reach():
    rows = [*two_problems("ida", 5000.0, 5000.0), *law("hht", 1.0, 2), failed("hht", 1e-4, problem="andrews")]
    line = lines_of(rows, problems=BOTH)[0]
    assert (line["cheapest"], line["cost"]) == ("ida", "500 ms")
    own = [line[name] for name in ("HHT", "place", "HHT's factor", "reaches", "why")]
    assert own == ["hht", "2 of 2", f"{times(0.0002)} | on 1", "1 of 2", "fails on 1"]


def test_who_was_run_on_a_part_of_the_problems_stands_behind():
    rows = [*two_problems("hht", 400.0, 400.0), *law("ida", 100.0, 2), *law("scipy", 900.0, 2, problem="andrews")]
    line = lines_of(rows, problems=BOTH)[0]
    assert (line["cheapest"], line["cost"], line["place"]) == ("hht", "40 ms", "1 of 3")
    assert (line["second"], line["factor"]) == ("ida | reaches 1 of 2", f"{times(0.25)} | on 1")


def why(rows, *asked, **changes):
    return [line["why"] or line["HHT"] for line in lines_of(rows, *asked, **changes)]


def test_hht_that_was_not_run_or_of_which_it_is_not_known_is_not_said_to_fail():
    ida = law("ida", 100.0, 2)
    assert [line["HHT"] for line in lines_of(ida)] == ["not run", "not run"]
    silent = [run("hht", setting, setting, None) for setting in (1e-2, 1e-4)]
    assert why([*ida, *silent], "evaluations")[0] == "evaluations not counted"
    part = [*two_problems("ida", 100.0, 100.0), *law("hht", 50.0, 2)]
    assert why(part, problems=BOTH)[0] == "not run on 1"
    coarse = law("hht", 50.0, 2, (1e-1,))
    assert why([*ida, *coarse]) == ["no run so accurate"] * 2
    assert why([*ida, *ladder(coarse)]) == ["campaign interrupted"] * 2
    assert why([*ida, *coarse, failed("hht(alpha=-0.3)", 1e-4)])[0] == "no run so accurate", "another entry fails"


def test_where_hht_or_nobody_reaches_the_error_the_table_says_so_and_not_where_it_is_not_known():
    rows = ladder([run("hht", 1e-1, 0.5, 10)], refinements=1)
    rows += ladder(law("ida", 100.0, 2, settings=(1e-1, 1e-2)), refinements=2)
    coarse, fine = lines_of(rows)
    assert (coarse["reaches"], coarse["why"]) == ("0 of 1", "limit of the campaign")
    assert fine["cheapest"] == "nobody reaches it"
    silent = [run("diffrax", setting, setting, None) for setting in (1e-2, 1e-4)]
    assert [line["cheapest"] for line in lines_of(silent, "evaluations")] == ["nobody reaches it, as far as is known"] * 2


def test_a_mean_that_rests_on_bounds_has_their_sign():
    least, about = "\N{GREATER-THAN OR EQUAL TO}", "\N{ALMOST EQUAL TO}"
    rows = [run("ida", 1e-3, 1e-5, 100), *law("hht", 40.0, 2)]
    coarse = lines_of(rows)[0]
    assert (coarse["cost"], coarse["factor"]) == (f"{AT_MOST} 1 ms", f"{least} {times(4)}")
    rows = [run("hht", 1e-3, 1e-5, 1000), *law("ida", 40.0, 2)]
    coarse = lines_of(rows)[0]
    assert (coarse["cost"], coarse["factor"]) == ("4 ms", f"{AT_MOST} {times(2.5)}")
    missed = failed("ida", 1e-4, problem="andrews")
    both = [run("ida", 1e-3, 1e-5, 400), missed]
    rows = [run("hht", 1e-3, 1e-5, 1000), *law("hht", 40.0, 2, problem="andrews"), *both]
    line = lines_of(rows, problems=BOTH)[0]
    assert line["cost"] == f"{AT_MOST} {work((0.01 * 0.004) ** 0.5, 'time')}"
    assert (line["second"], line["factor"]) == ("ida | reaches 1 of 2", f"{about} {times(0.4)} | on 1")


def test_what_is_only_a_bound_is_not_called_equal():
    rows = [*law("ida", 40.0, 2), run("hht", 1e-3, 1e-5, 420)]
    assert lines_of(rows)[0]["factor"] == f"{AT_MOST} {times(1.05)}"


def said(rows, problems=("pendulum",), **changes):
    return " ".join(recommendations(choices_of(rows, {KIND: problems}, WHOLE), WHOLE.level, changes.get("held_out", ())))


def test_sentences_say_what_to_take_how_much_cheaper_it_is_than_hht_and_whether_it_drifts():
    rows = [*law("hht", 400.0, 2, drift=1e-14), *law("ida", 50.0, 2, drift=1e-5)]
    text = said(rows, held_out={"pendulum"})
    assert "For joints with smooth forces (1 problem, 1 held out) at an error of 1e-4 take ida; " in text
    assert "it is about 8 times cheaper than HHT (hht)." in text
    assert "It does not keep drift below 1e-10; hht does." in text
    assert "It keeps drift below 1e-10." in said(law("hht", 400.0, 2, drift=1e-14))
    assert "HHT (hht) costs about the same." in said([*law("hht", 70.0, 2), *law("ida", 50.0, 2)])
    assert "take hht; it is about 2.0 times cheaper than ida." in said([*law("hht", 50.0, 2), *law("ida", 100.0, 2)])
    assert "HHT was not run." in said(law("ida", 50.0, 2))


def test_sentences_say_where_hht_is_not_known_to_reach_an_error_and_what_it_reaches():
    rows = [*law("ida", 100.0, 2), *law("hht", 50.0, 2, (1e-1,))]
    assert "HHT (hht) does not reach it (no run so accurate)." in said(rows)
    part = [*two_problems("ida", 100.0, 100.0), *law("hht", 25.0, 2), failed("hht", 1e-4, problem="andrews")]
    text = said(part, BOTH)
    assert "HHT (hht) is about 4 times cheaper where both reach it but reaches it on 1 of 2 problems." in text


def test_a_sentence_says_when_not_to_take_the_solver_that_is_cheapest_most_often():
    rows = [*law("scipy", 100.0, 2), *law("hht", 1000.0, 2), *law("rattle", 400.0, 1, (1e-1, 1e-2))]
    assert "scipy is the cheapest in 2 of 2 rows of the table, and no row speaks against it." in said(rows)
    stiff = Kind(constraints="position constraints", forces=VIBRATIONS)
    rows += [*law("hht", 100.0, 2, problem="andrews"), failed("scipy", 1e-4, "declined", problem="andrews")]
    kinds = {KIND: ("pendulum",), stiff: ("andrews",)}
    *_, text, few = recommendations(choices_of(rows, kinds, WHOLE), WHOLE.level, ())
    assert text.startswith(
        "scipy is the cheapest in 2 of 4 rows of the table. Do not take it for joints with stiff vibrations at "
    )
    assert "at 1e-2 and 1e-4 (not supported; take HHT)" in text
    assert few.startswith("Rows on fewer than 3 problems (2 kinds) are a hint")


def test_every_kind_leads_to_its_evidence_which_names_its_problems(whole, rows):
    first = whole.partition('data-table="time any"')[2].partition("</div></div>")[0]
    links = set(re.findall(r'<td><a href="#(plot-kind-[^"]*)">', first))
    named = []
    for link in links:
        section = whole.partition(f'<details class="part" id="{link}">')[2].partition("<table>")[0]
        named += re.findall(r'<a href="#plot-[^"]*">(.*?)</a>', section)
    judged = {name for kind, names in analysis.kinds(rows).items() for name in names}
    assert set(named) <= judged
    assert "andrews" in named
    assert len(named) == len(set(named))


def _traces(view, entry):
    return [trace for trace in view[0]["data"] if trace["name"] == entry]


def test_drift_figure_has_a_point_for_each_problem_and_the_median_large():
    rows = [*law("hht", 100.0, 2, drift=1e-15)]
    for problem, factor, drift in (("pendulum", 50.0, 1e-9), ("andrews", 200.0, 1e-7), ("car", 300.0, 1e-8)):
        rows += law("ida", factor, 2, drift=drift, problem=problem)
        rows += law("hht", 100.0, 2, drift=1e-15, problem=problem) if problem != "pendulum" else []
    view = drift_views(rows, solver_styles(["hht", "ida"]))["time"]
    single, middle = _traces(view, "ida")
    assert sorted(single["x"]) == pytest.approx([0.5, 2.0, 3.0])
    assert (middle["x"], middle["y"]) == ([2.0], [1e-8])
    assert drift_views([row for row in rows if row.solver == "ida"], solver_styles(["ida"])) == {}


def test_drift_figure_leaves_out_costs_that_are_only_bounds_and_says_whose():
    rows = [*law("hht", 100.0, 2, drift=1e-15), run("ida(form=ggl)", 1e-3, 1e-6, 100)]
    rows[-1].metrics["drift"] = {"position": 1e-9, "velocity": 1e-9}
    assert "Left out" not in drift_views(rows[:-1], solver_styles(["hht"]))["time"][1]
    rows += law("ida(form=ggl)", 50.0, 2, drift=1e-8, problem="andrews")
    rows += law("hht", 100.0, 2, drift=1e-15, problem="andrews")
    fine = [run("hht", 1e-3, 1e-6, 100, problem="car"), *law("ida(form=ggl)", 50.0, 2, drift=1e-8, problem="car")]
    fine[0].metrics["drift"] = {"position": 1e-15, "velocity": 1e-15}
    view = drift_views([*rows, *fine], solver_styles(["hht", "ida(form=ggl)"]))["time"]
    single, middle = _traces(view, "ida(form=ggl)")
    assert (single["x"], middle["text"]) == ([0.5], ["ida(ggl), 1 of 2"])
    assert "On each of 2 problems" in view[1]
    left_out = view[1].partition("Left out, because the cheapest run or HHT's is more accurate than asked: ")[2]
    assert set(left_out.rstrip(".").split("; ")) == {"hht on 1", "ida(ggl) on 2"}


def test_profile_is_drawn_by_time_and_by_evaluations_with_the_chosen_solvers_in_front(rows):
    styles = solver_styles(analysis.entries(rows))
    views = profile_views(rows, styles, ["hht(alpha=0)"])
    assert list(views) == ["time", "evaluations"]
    assert views["time"][0]["front"] == ["hht(alpha=0)"]
    (line,) = _traces(views["time"], "hht(alpha=0)")
    assert line["y"] == sorted(line["y"])
    assert line["x"] == sorted(line["x"])


def test_hht_and_who_has_an_unbeaten_run_are_shown_first():
    rows = [*law("hht", 100.0, 2), *law("ida", 10.0, 2), *law("scipy", 1000.0, 2)]
    assert {chart.front for chart in problem_charts(rows)} == {frozenset({"hht", "ida"})}


def test_failures_of_a_problem_are_grouped_by_reason_whatever_the_numbers_in_it():
    rows = [failed("ida", 1e-3, message="no convergence at t = 0.1"), failed("ida", 1e-4, message="no convergence at t = 2")]
    rows += [failed("scipy", 1e-4, message="no convergence at t = 3e-2"), failed("cvode", 1e-4, "declined", "no form")]
    table = failures_by_reason(rows)
    assert [[cell.text for cell in line] for line in table.rows] == [
        [
            "newton_failed",
            "3",
            "ida, 2 runs; scipy, rtol 1e-04",
            NOTHING,
            "no convergence at t = 0.1 (the first; numbers differ)",
        ],
        ["declined", "1", "cvode, rtol 1e-04", NOTHING, "no form"],
    ]


def test_no_failed_run_is_left_out_of_the_tables_of_failures(rows):
    lost = [row for row in rows if not row.success]
    told = sum(one.runs for one in failure_atlas(rows).failures if one.cause != SILENT)
    assert told == sum(row.status != DECLINED for row in lost)
    for problem in analysis.problems(rows):
        own = [row for row in rows if row.problem == problem]
        counted = sum(int(line[1].text) for line in failures_by_reason(own).rows)
        assert counted == sum(row.problem == problem for row in lost)


def test_foot_names_commit_campaign_command_and_machine(rows, tmp_path):
    asked = {"accuracies": [1e-2, 1e-4], "max_seconds": 1.0, "pair_seconds": 2.0, "refinements": 14}
    kept = [
        replace(row, request={**row.request, "rules": asked}, environment={**row.environment, "commit": "abc123"})
        for row in rows[:20]
    ]
    write_comparison(kept, tmp_path, COMMAND)
    foot = (tmp_path / "index.html").read_text(encoding="utf-8").partition("<footer")[2].partition("</footer>")[0]
    assert "commit abc123" in foot
    assert f"<code>{COMMAND}</code>" in foot
    assert "errors 1e-02, 1e-04; of one solver on one problem at most 14 runs, 1 s each, 2 s in all." in foot
    assert "cores 2" in foot


def test_foot_names_the_settings_where_these_were_given_and_no_errors():
    text = campaign_line([*law("ida", 50.0, 4, settings=(1e-2, 1e-4)), run("hht", 1e-4, 1e-3, 10)])
    assert text == "Campaign: 1 problem, 2 solvers, settings given: rtol 1e-02, rtol 1e-04."


def test_a_mark_at_the_edge_has_no_value_there_for_the_data_to_tell():
    rows = [*law("ida", 50.0, 4), run("ida", 1e-7, None, 300, status="deadline", message="the budget is used up")]
    (chart,) = [chart for chart in problem_charts(rows) if chart.id == "work-evaluations"]
    (mark,) = [trace for trace in draw(chart, solver_styles(["ida"]))["data"] if trace["mode"] == "markers"]
    assert mark["meta"] == {"x": 300, "y": None}
    assert mark["y"][0] > 0.1


def test_short_names_leave_out_what_tells_itself():
    assert short("scipy(method=DOP853)") == "scipy(DOP853)"
    assert short("hht(alpha=-0.05), steps=N") == "hht(-0.05), steps=N"
    assert short("minimal(alpha=-0.05, solver=hht)") == "minimal(-0.05, hht)"
    assert [short(entry) for entry in ("hht(alpha=0)", "hht(rho_inf=0)")] == ["hht(alpha=0)", "hht(rho_inf=0)"]


def test_names_in_the_drift_figure_hide_no_other():
    """Ten marks in one place, and one apart: the first are named around it, the one apart too, the rest in the legend."""
    medians = {f"solver {i}": (1.0, 1e-15) for i in range(10)} | {"apart": (10.0, 1e-5)}
    places = _label_places({name: name for name in medians}, medians, ([-1.0, 2.0], [-18.0, -4.0]))
    assert list(places) == ["solver 0", "solver 1", "solver 2", "solver 3", "apart"]
    assert len({places[name] for name in places if name != "apart"}) == 4
