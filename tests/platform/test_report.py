from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import plotly.graph_objects as go
import pytest

from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.evidence import SCHEMA, Curve, Evidence, Plot, Row, read_evidence
from hhtbench.report import write_report
from hhtbench.report.colours import PALETTE, plot_style, style_numbers
from hhtbench.report.figures import figure as made
from hhtbench.report.wording import verdict
from tests.report.drawings import embedded, figures_of

STEPS = (0.1, 0.05, 0.025)
COMMAND = "hhtbench verify paper --report reports/latest"


def _curve(label, power=2.0):
    return Curve(label=label, x=STEPS, y=tuple(h**power for h in STEPS))


def _plot(*curves, **changes):
    values = {
        "id": "5.1/q",
        "title": "Error of q",
        "caption": "It falls by four.",
        "x_label": "h [s]",
        "y_label": "error [m]",
    }
    return Plot(**{**values, "curves": curves or (_curve("alpha = 0"),), **changes})


def figure(plot, styles):
    return go.Figure(made(plot, styles))  # which refuses what plotly does not know


ROWS = (
    Row(id="5.1/q", claim="max |g| < 1e-9 & a*b", measured=2.0, bound="2.00 +- 0.05", passed=True),
    Row(id="5.1/v", claim="order of v", measured=1.99, bound="2.00 +- 0.05", passed=True),
    Row(id="6/time", claim="time", measured="3 s", bound="not judged", passed=None),
)
EVIDENCE = Evidence(title="Paper </script> & claims", rows=ROWS, plots=(_plot(slope=2.0),), seconds=75.0)


class Sources(HTMLParser):
    """Collects what a browser would fetch."""

    def __init__(self):
        super().__init__()
        self.fetched = []
        self.open = []

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        if tag != "a":
            self.fetched += [found[key] for key in ("src", "href", "srcset", "data") if key in found]
        self.open.append(tag)


@pytest.fixture
def report(tmp_path):
    write_report(EVIDENCE, tmp_path / "new" / "folder", COMMAND)
    return tmp_path / "new" / "folder"


def test_page_fetches_nothing_and_holds_plotly_once(report):
    text = (report / "convergence.html").read_text(encoding="utf-8")
    parser = Sources()
    parser.feed(text)
    assert parser.fetched == []
    assert "@import" not in text.partition("</style>")[0]
    assert parser.open.count("script") == 3  # the figures, plotly, the loop that draws
    assert "plotly.js (basic - minified) v" in embedded(text, "plotly")


def test_page_shows_heading_figure_and_caption_and_escapes_the_title(report):
    text = (report / "convergence.html").read_text(encoding="utf-8")
    assert "<h1>Paper &lt;/script&gt; &amp; claims</h1>" in text
    section = re.search(r'<section id="plot-5-1-q">(.*?)</section>', text, re.DOTALL)[1]
    assert "<h2>Error of q</h2>" in section
    assert '<p class="caption">It falls by four.</p>' in section
    assert 'data-figure="0"' in section
    (drawn,) = figures_of(text).values()
    assert [curve["name"] for curve in drawn["data"]] == ["slope 2", "alpha = 0"]


def test_label_that_closes_a_script_stays_inside_its_string(tmp_path):
    write_report(replace(EVIDENCE, plots=(_plot(_curve("</script><b>")),)), tmp_path, COMMAND)
    text = (tmp_path / "convergence.html").read_text(encoding="utf-8")
    assert figures_of(text)[0]["data"][0]["name"] == "</script><b>"
    assert "</script><b>" not in text


def test_markdown_groups_the_rows_and_links_the_curves(report):
    text = (report / "report.md").read_text(encoding="utf-8")
    assert "**All 2 claims hold. 1 further row is printed and not judged.**" in text
    first, second = text.split("## 5.1\n")[1].split("## 6\n")
    assert first.count("\n| 5.1/") == 2
    assert second.count("\n| 6/") == 1
    assert "(convergence.html#plot-5-1-q)" in first
    assert COMMAND in text
    assert "Wall time: 75.0 s." in text
    assert "| python" in text


def test_bars_in_a_claim_do_not_end_the_table_cell(report):
    line = next(line for line in (report / "report.md").read_text(encoding="utf-8").splitlines() if "| 5.1/q" in line)
    assert len(re.findall(r"(?<!\\)\|", line)) == 6


def test_verdict_names_what_fails_and_never_passes_without_a_judged_row():
    failing = (ROWS[0], replace(ROWS[1], passed=False))
    assert verdict(Evidence(title="t", rows=failing)) == "1 of 2 claims fails: 5.1/v."
    empty = Evidence(title="t", rows=ROWS[2:])
    assert not empty.passed
    assert verdict(empty) == "Nothing was judged, so nothing is shown."


def test_report_without_curves_is_written(tmp_path):
    write_report(replace(EVIDENCE, plots=()), tmp_path, COMMAND)
    assert "No curves were recorded" in (tmp_path / "convergence.html").read_text(encoding="utf-8")


def test_folder_that_cannot_be_made_is_explained(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ProblemError, match="report cannot be written"):
        write_report(EVIDENCE, tmp_path / "file" / "folder", COMMAND)


def test_values_that_cannot_be_drawn_stand_at_the_edge_and_are_not_dropped():
    curve = Curve(label="fails", x=(0.1, 0.05, 0.025, 0.01), y=(1e-2, math.nan, 0.0, 1e-4))
    drawn = figure(_plot(curve), {"fails": 0})
    line, *marks = drawn.data
    assert list(line.y) == [1e-2, None, None, 1e-4]
    assert [mark.x[0] for mark in marks] == pytest.approx([0.05, 0.025])
    assert [mark.marker.symbol for mark in marks] == ["triangle-up-open", "triangle-down-open"]
    low, high = drawn.layout.yaxis.range
    assert all(low - 1e-12 <= math.log10(mark.y[0]) < high for mark in marks)


def test_guide_line_has_the_stated_slope_and_runs_below_the_curves():
    drawn = figure(_plot(_curve("a"), slope=2.0), {"a": 0})
    guide = drawn.data[0]
    slope = np.diff(np.log(guide.y)) / np.diff(np.log(guide.x))
    assert slope == pytest.approx(2.0)
    assert guide.y[0] == pytest.approx(0.5 * guide.x[0] ** 2)


def test_logarithmic_axes_have_decade_ticks():
    wide = figure(_plot(_curve("a", power=3.0)), {"a": 0}).layout
    assert (wide.xaxis.type, wide.yaxis.type, wide.yaxis.dtick) == ("log", "log", 1)
    assert figure(_plot(logarithmic=False), {"alpha = 0": 0}).layout.xaxis.type is None


def test_label_keeps_its_colour_on_all_plots_and_curves_of_one_plot_differ():
    plots = [_plot(_curve("a"), _curve("b")), _plot(_curve("b"), _curve("c")), _plot(_curve("a"), _curve("c"))]
    numbers = style_numbers(plots)
    assert numbers[0]["b"] == numbers[1]["b"]
    assert all(len(set(own.values())) == len(own) for own in numbers)


def test_first_28_styles_differ():
    looks = {(style.colour, style.dash) for style in map(plot_style, range(4 * len(PALETTE)))}
    assert len(looks) == 28


def test_evidence_json_keeps_the_contract(report):
    found = json.loads((report / "evidence.json").read_text(encoding="utf-8"))
    assert {"schema", "passed", "rows", "environment"} <= set(found)
    assert found["schema"] == SCHEMA
    assert found["passed"] is True
    assert [set(row) for row in found["rows"]] == [{"id", "claim", "measured", "bound", "passed"}] * 3


def test_evidence_of_library_scalars_and_of_nan_is_valid_json(tmp_path):
    rows = (
        Row(id="a", claim="c", measured=np.float32(0.5), bound="b", passed=np.bool_(True)),
        Row(id="b", claim="c", measured=np.nan, bound="b", passed=False),
    )
    Evidence(title="t", rows=rows).write_json(tmp_path / "e.json")

    def refuse(text):
        raise ValueError(text)

    found = json.loads((tmp_path / "e.json").read_text(), parse_constant=refuse)
    assert [(row["measured"], row["passed"]) for row in found["rows"]] == [(0.5, True), ("nan", False)]


def test_evidence_comes_back_as_it_was_written(tmp_path):
    EVIDENCE.write_json(tmp_path / "e.json")
    found = read_evidence(tmp_path / "e.json")
    assert (found.title, found.rows, found.environment) == (EVIDENCE.title, EVIDENCE.rows, EVIDENCE.environment)


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", json.dumps({"schema": "other/1", "title": "", "rows": [], "environment": {}})]
)
def test_file_that_is_no_evidence_is_explained(text, tmp_path):
    (tmp_path / "e.json").write_text(text)
    with pytest.raises(ProblemError, match=r"verify again|Verify again"):
        read_evidence(tmp_path / "e.json")
