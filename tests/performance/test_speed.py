"""Machine speed in the comparison: what is compared, ratios, times, drift, labelled axes; nothing without measurements."""

import json
import re
from dataclasses import asdict

import pytest

from hhtbench.errors import ProblemError
from hhtbench.report import write_comparison
from hhtbench.report.drawings import Drawings
from hhtbench.report.speed_contest import contest_rows, contest_table, everyone_table, summary
from hhtbench.report.speed_section import speed_section
from hhtbench.report.words import times
from tests.analysis.laws import failed, law
from tests.report.conftest import COMMAND
from tests.report.drawings import figures_of

SETTINGS = (1e-1, 1e-2, 1e-3, 1e-4)
RUNS = [
    *law("hht(alpha=-0.05)", 10.0, 2, SETTINGS, 1e-15),
    *law("projected(method=DOP853)", 40.0, 2, SETTINGS, 2e-16),
    *law("scipy(method=DOP853)", 5.0, 2, SETTINGS, 3e-4),
    failed("ida(form=index3)", 1e-2, "newton_failed", "the corrector <did> not converge"),
]
RUNS[4].timing["callbacks"] = {"functions": 0.4, "guards": 0.25, "calls": 10, "microseconds": 9.0}
RUNS[4].timing["start_s"] = 2e-3


def judged(value, low, high, limit, verdict):
    """What a measured line tells."""
    return {"value": value, "low": low, "high": high, "count": 8, "clock": value, "limit": limit, "verdict": verdict}


STEP = {
    "scene": "pendulum",
    "h": 1e-3,
    "steps": 4000,
    "ours_s": 4.06e-7,
    "c_s": 5e-7,
    **judged(0.812, 0.8, 0.83, 1.0, "holds"),
    "start_s": 1e-3,
    "difference": 2e-15,
    "iterations": 2.0,
    "c_iterations": 2.1,
    "note": "",
}
COMPILED = {"scene": "pendulum", "note": "", "imports_s": 1.0, "solve_s": 1e-3}
CHAIN = {"h": 1e-4, "steps": 400, "note": "", "ours_s": 1e-6, "theirs_s": 2e-6, "solver": "EXUdense"}
DUEL = {"problem": "pendulum", "subject": "hht(alpha=-0.05)", "low": 3.5, "high": 4.5, "count": 8}
HOLDER = DUEL | {"kind": "holder", "rival": "projected(method=DOP853)", "value": 4.0, "verdict": "faster"}
EXPLICIT = DUEL | {"rival": "scipy(method=DOP853)", "value": 0.5, "low": 0.4, "high": 0.6, "verdict": "slower"}
SPEED = {
    "schema": 1,
    "engine": "compiled",
    "created": "2026-11-22T01:00:00Z",
    "environment": {"python": "3.11", "processor": "<Test> & Co"},
    "seconds": 12.0,
    "steps": [STEP],
    "compiling": [
        COMPILED | {"cache": "empty"} | judged(1.2, 1.1, 1.3, 1.5, "holds"),
        COMPILED | {"cache": "own"} | judged(0.15, 0.1, 0.25, 0.2, "not decided"),
    ],
    "chains": [
        CHAIN | {"links": 1, "error": 1e-9, "their_error": 2e-9} | judged(0.2, 0.19, 0.21, 0.25, "holds"),
        CHAIN | {"links": 10, "error": 1e-8, "their_error": 2e-8} | judged(0.73, 0.7, 0.75, 0.5, "BROKEN"),
    ],
    "memory": [{"what": "memory of many steps", "unit": "MB", "note": "", **judged(7.0, 7.0, 7.0, 50.0, "holds")}],
    "runs": [asdict(row) for row in RUNS],
    "duels": [
        duel | {"target": target}
        for target in (1e-2, 1e-3, 1e-4)
        for duel in (HOLDER, *(EXPLICIT | {"kind": kind} for kind in ("other", "explicit")))
    ],
}


def written(folder, speed=SPEED):
    (folder / "speed.json").write_text(json.dumps(speed), encoding="utf-8")
    drawings = Drawings()
    return speed_section(folder, drawings) + drawings.scripts("")


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return written(tmp_path_factory.mktemp("speed"))


def test_page_says_what_is_compared_and_shows_times_ratios_and_limits(page):
    for text in (
        "hand-written C",
        "Exudyn",
        "machine code",
        "0.812",
        "limit 1",
        "0.406 \N{MICRO SIGN}s",
        "EXUdense",
        "limit 1.5 s",
        "memory of many steps",
        '"compiled"',
    ):
        assert text in page, text
    assert re.search(r'<td class="good[^>]*>0\.2<small>0\.19 to 0\.21, 8 rounds; limit 0\.25: holds', page)
    assert re.search(r'<td class="bad[^>]*>0\.73<small>0\.7 to 0\.75, 8 rounds; limit 0\.5: BROKEN', page)
    assert re.search(r"<td>150 ms<small>100 ms to 250 ms, 8 rounds; limit 200 ms: not decided", page)
    assert "7 MB<small>limit 50 MB: holds" in page, "what is counted has no interval"
    assert "&lt;Test&gt; &amp; Co" in page


def test_page_draws_every_error_with_labelled_axes(page):
    figures = figures_of(page)
    assert len(figures) == 3
    for figure in figures:
        assert figure["layout"]["xaxis"]["title"]["text"] == "processor time of one solve [s]"
        assert figure["layout"]["yaxis"]["title"]["text"] == "problem"
        assert figure["data"][0]["name"] == "HHT"
        assert all(len(trace["x"]) == 1 for trace in figure["data"])
    low, high = figures[0]["layout"]["xaxis"]["range"]
    assert low < -3.31 < -3.0 < high, "0.5 ms to 4 ms"


def test_page_shows_drift_and_that_an_explicit_method_is_faster(page):
    assert f"explicit DOP853 on the underlying ODE is faster than HHT on 1, typically {times(2)}" in page
    assert f"HHT {times(2)} its time; drift 3.0e-04" in page
    assert f"HHT faster by {times(4)}" in page
    assert "projected(method=DOP853): 4 times HHT" in page
    assert "3.5 to 4.5 in 8 rounds" in page


def test_a_comparison_that_is_not_decided_counts_for_nobody(tmp_path):
    open_ones = [duel | {"low": 0.5, "high": 5.0, "verdict": "not decided"} for duel in SPEED["duels"]]
    page = written(tmp_path, {**SPEED, "duels": open_ones})
    assert "HHT faster by" not in page
    assert "below 1e-10 on 0 (not decided on 1)" in page
    assert "is faster than HHT on 0." in page


def test_who_fails_says_why_on_the_page(page):
    assert "newton_failed 1 of 1" in page
    assert "the corrector &lt;did&gt; not converge" in page


def test_shares_of_callbacks_are_shown(page):
    assert re.search(r"projected\(method=DOP853\)</td>.*?>2 ms<.*?40%.*?25%.*?35%", page, re.DOTALL)


def test_sections_that_were_not_measured_are_named(tmp_path):
    page = written(tmp_path, {**SPEED, "chains": [], "runs": [], "duels": []})
    named = re.search(r"Not measured in this run: (.*?)\.</p>", page).group(1)
    assert named.startswith("Time per step beside Exudyn, What a solve costs")
    assert named.endswith("At equal error, beside the reference solvers")
    assert "EXUdense" not in page


def test_a_missing_compiler_is_told_and_nothing_is_called_broken(tmp_path):
    names = ("c_s", "value", "low", "high", "clock", "difference", "iterations", "c_iterations")
    line = STEP | dict.fromkeys(names) | {"verdict": "not measured", "note": "there is no C compiler"}
    page = written(tmp_path, {**SPEED, "steps": [line]})
    assert "there is no C compiler" in page
    assert "not measured<small>limit 1<" in page


def test_the_comparison_shows_machine_speed_only_where_it_was_measured(rows, tmp_path):
    def shown():
        write_comparison(rows, tmp_path, COMMAND)
        return (tmp_path / "index.html").read_text(encoding="utf-8")

    without = shown()
    assert 'id="speed"' not in without and "#speed" not in without
    section = written(tmp_path).partition("<script")[0]
    page = shown()
    assert section.strip() in page and '<a href="#speed">machine speed</a>' in page
    assert len(figures_of(page)) == len(figures_of(without)) + 3
    targets = re.findall(r'href="#(plot-speed[^"]*)"', page)
    assert len(targets) == 5 and all(page.count(f'id="{target}"') == 1 for target in targets)
    (tmp_path / "speed.json").unlink()
    assert shown() == without


@pytest.mark.parametrize("page", ["b/convergence.html", "stability.html"])
def test_the_report_links_the_page_of_a_study_where_it_is_there(rows, tmp_path, page):
    write_comparison(rows, tmp_path, COMMAND)
    assert page not in (tmp_path / "index.html").read_text(encoding="utf-8")
    (tmp_path / page).parent.mkdir(exist_ok=True)
    (tmp_path / page).write_text("curves", encoding="utf-8")
    write_comparison(rows, tmp_path, COMMAND)
    assert f'href="{page}"' in (tmp_path / "index.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("text", ["{", "[]", '{"engine": "compiled", "steps": [{}]}'])
def test_a_file_that_is_not_speed_is_refused_with_the_way_out(tmp_path, text):
    (tmp_path / "speed.json").write_text(text, encoding="utf-8")
    with pytest.raises(ProblemError, match="make bench-engine"):
        speed_section(tmp_path, Drawings())


def test_tables_hold_every_solver_and_every_error():
    rows = contest_rows(SPEED)
    assert [row[0].text for row in everyone_table(rows, "pendulum").rows] == [
        "hht(alpha=-0.05)",
        "ida(form=index3)",
        "scipy(method=DOP853)",
        "projected(method=DOP853)",
    ]
    assert [row[1].text for row in contest_table(rows).rows] == ["1e-02", "1e-03", "1e-04"]
    assert len(summary(rows)) == 3
