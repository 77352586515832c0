from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from html import escape
from html.parser import HTMLParser
from importlib.resources import files
from itertools import product

import pytest
from plotly.offline import get_plotlyjs_version

from hhtbench.protocol.errors import ProblemError
from hhtbench.report import content_of, contest, summary_page, write_comparison
from hhtbench.report.atlas import failure_atlas
from hhtbench.report.elements import sketch
from hhtbench.report.markdown import escape_text, markdown_table
from hhtbench.report.tables import make_table
from tests.analysis.laws import failed, law
from tests.report.conftest import COMMAND
from tests.report.drawings import embedded, figures_of, opened, scripts_of
from tests.report.synthetic import PROBLEMS, SOLVERS

MOST_BYTES = 3e6
LABELS = [solver.replace("'", "") for solver in SOLVERS]


class Sources(HTMLParser):
    """Collects what a browser would fetch and where links lead."""

    def __init__(self):
        super().__init__()
        self.fetched, self.links, self.ids, self.buttons = [], [], [], []

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        if tag == "a":
            self.links.append(found["href"])
        else:
            sources = [found[key] for key in ("src", "href", "srcset", "data") if key in found]
            self.fetched += [source for source in sources if not source.startswith("data:")]
        if "id" in found:
            self.ids.append(found["id"])
        if "data-entry" in found:
            self.buttons.append(found["data-entry"])


@pytest.fixture(scope="module")
def parsed(whole):
    parser = Sources()
    parser.feed(whole)
    return parser


def sections(whole):
    """Problem -> all about it."""
    parts = whole.partition('<h2 id="problems">')[2].partition('<h2 id="atlas">')[0].split('<details class="part"')[1:]
    return {re.search(r"<h3>(.*?)</h3>", part)[1]: part for part in parts}


def figures(page):
    """Title and view -> figure, for each problem."""
    drawn, found = figures_of(page), {}
    for problem, section in sections(opened(page)).items():
        found[problem] = {}
        for figure in re.findall(r"<figure .*?</figure>", section, re.DOTALL):
            title = re.search(r"<h3>(.*?)</h3>", figure)[1]
            (first,) = re.findall(r'<div class="plot" data-figure="(\d+)"></div>', figure)
            views = re.findall(r'data-figure="(\d+)" aria-pressed="\w+">(.*?)</button>', figure) or [(first, "")]
            found[problem] |= {(title, view): drawn[int(number)] for number, view in views}
    return found


def test_page_fetches_nothing_and_holds_plotly_once(page, parsed):
    assert parsed.fetched == []
    assert "@import" not in page.partition("</style>")[0]
    assert embedded(page, "plotly").startswith(f"/**\n* plotly.js (basic - minified) v{get_plotlyjs_version()}")
    assert len(page) < MOST_BYTES


def test_tables_and_figures_of_problems_are_compressed_until_they_are_opened(page, whole):
    assert page.count("<td") < whole.count("<td") / 8
    (first,) = [json.loads(text) for name, text in scripts_of(page) if name == "figures"]
    assert len(first["figures"]) == 4 < len(figures_of(page)) / 10


def test_a_name_with_its_options_is_never_broken(whole):
    text = re.sub(r'<span class="whole">.*?</span>', "", re.sub(r"<td>[^<]*", "<td>", whole.partition("<body>")[2]))
    assert not re.findall(r"<(?:li|p|small)[^>]*>[^<]*\w\([a-z]+=", text)


def test_links_lead_somewhere(whole, parsed):
    inside = [link[1:] for link in parsed.links if link.startswith("#")]
    assert set(inside) <= set(parsed.ids)
    assert {"decision", "problems", "findings", "rules", "machine"} <= set(parsed.ids)
    named = re.findall(r'<details class="part" id="(plot-[^"]*)">', whole)
    assert len(named) == len(PROBLEMS) + len(set(re.findall(r'href="#(plot-kind-[^"]*)"', whole)))
    assert set(named) <= set(inside)
    assert {link for link in parsed.links if not link.startswith("#")} == {"summary.md"}
    assert len(set(parsed.ids)) == len(parsed.ids)


@pytest.mark.parametrize("name", ["convergence.html", "report.md", "b/convergence.html", "stability.html", "speed.html"])
def test_pages_of_other_commands_are_linked_where_they_are(rows, evidence, tmp_path, page, name):
    assert f'href="{name}"' not in page
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("")
    write_comparison(rows[:5], tmp_path, COMMAND, evidence)
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert f'<a href="{name}">' in text
    assert "The one claim holds." in text


def test_failing_verification_is_shown_as_failing(rows, evidence, tmp_path):
    failing = replace(evidence, rows=(replace(evidence.rows[0], passed=False),))
    write_comparison(rows[:5], tmp_path, COMMAND, failing)
    assert '<p class="verdict bad">' in (tmp_path / "index.html").read_text(encoding="utf-8")


def test_every_problem_and_every_solver_appears(whole, parsed):
    assert set(parsed.buttons) == set(LABELS)
    assert set(sections(whole)) == set(PROBLEMS)


def test_a_problem_of_the_library_is_shown_and_one_of_ones_own_needs_no_drawing(whole):
    for problem, section in sections(whole).items():
        file = files("problems").joinpath("thumbnails", f"{problem.partition('(')[0]}.png")
        assert section.count('<div class="sketch"') == 1
        assert base64.b64encode(file.read_bytes()).decode() in section
        assert ("default parameters" in section.partition("</div>")[0]) == ("(" in problem)
    assert sketch("my.py:crane(mass=2)") == sketch("no_such_problem") == ""


def test_every_row_is_in_the_table_of_all_runs(whole, rows):
    for problem in PROBLEMS:
        own = [row for row in rows if row.problem == problem]
        table = whole.partition(f"All {len(own)} runs on {problem}</summary>")[2].partition("</details>")[0]
        assert table.count("<tr>") == len(own) + 1
        assert table.count('"bad"') == sum(not row.success for row in own)


def test_every_problem_has_its_charts(page):
    found = {problem: list(charts) for problem, charts in figures(page).items()}
    assert found["andrews"] == [
        ("Work and precision", "time"),
        ("Work and precision", "evaluations"),
        ("Work and precision", "drift"),
        ("Convergence", ""),
        *(("Over time", f"{level} drift") for level in ("position", "velocity", "acceleration")),
        ("Over time", "energy"),
        ("Over time", "momentum"),
        ("Multipliers", "λ over time"),
        ("Multipliers", "error of λ"),
    ]
    assert ("Multipliers", "μ over time") in found["knife_edge"]
    assert ("Over time", "position drift") not in found["knife_edge"]
    assert ("Multipliers", "error of μ") in found["knife_edge"]
    assert ("Work and precision", "time") not in found["planar_chain(n_links=4)"]


def test_every_solver_is_on_every_chart_as_curve_or_mark(page, whole):
    absent = re.sub("<.*?>", "", " ".join(re.findall(r"No series: (.*?)</p>", whole, re.DOTALL)))
    for problem, charts in figures(page).items():
        for title, figure in charts.items():
            if title[1] == "drift":
                continue
            named = {trace["name"] for trace in figure["data"]}
            if _over_time(title):
                named |= {label for label in LABELS if label in absent}
            assert named == set(LABELS), (problem, title)


def _over_time(title):
    return title[0] == "Over time" or title[1].endswith("over time")


def test_series_of_a_page_are_thin(page):
    for charts in figures(page).values():
        for title, figure in charts.items():
            if _over_time(title):
                assert max(len(trace["x"]) for trace in figure["data"] if trace["mode"] == "lines") < 60


def test_signs_of_html_in_texts_of_rows_are_harmless(rows, tmp_path):
    message = "</script><b>boom</b>"
    broken = replace(rows[0], status="newton_failed", message=message, solver="mine.py:solve(name='</script><i>')")
    write_comparison([broken, *rows[1:10]], tmp_path, COMMAND)
    text = opened((tmp_path / "index.html").read_text(encoding="utf-8"))
    assert message not in text
    assert "<i>" not in re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    assert escape(message) in text


def test_no_name_of_a_solver_opens_a_script_inside_a_chart(rows, tmp_path):
    strange = [replace(row, solver="mine.py:solve(name='<!--<script>')") for row in rows[:10]]
    write_comparison([*strange, *rows[10:]], tmp_path, COMMAND)
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert any("<!--<script>" in trace["name"] for figure in figures_of(text).values() for trace in figure["data"])
    assert "<!--" not in text  # a browser reads "<!--<script>" as a script within the script


def test_one_who_has_no_cost_is_named_and_several_are_counted():
    missing = [failed("ida(form=ggl)", 1e-4), failed("rattle", 1e-4)]
    told = [contest.cheapest([*law("hht", 100.0, 2), *missing[:n]]).rows[0][-1].text for n in (1, 2)]
    assert told == ["ida(ggl): newton_failed 1 of 1", "2: newton_failed 1 of 1"]


def test_older_row_of_a_cell_is_left_out_and_said(rows, tmp_path):
    old = replace(rows[0], key="old", created="2025-01-01T00:00:00+00:00", status="deadline", message="of old code")
    write_comparison([old, *rows[:10], replace(old, key="older")], tmp_path, COMMAND)
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "1 cell of the store exists in up to 3 versions" in text
    assert "2 older are left out" in text
    assert "of old code" not in opened(text)


def test_folder_that_cannot_be_made_is_explained(rows, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ProblemError, match="report cannot be written"):
        write_comparison(rows[:1], tmp_path / "file" / "folder", COMMAND)


@pytest.mark.parametrize("kept", [0, 1, 5])
def test_report_of_few_rows_is_written(rows, kept, tmp_path):
    write_comparison(rows[:kept], tmp_path, COMMAND)
    for name in ("index.html", "summary.md"):
        text = (tmp_path / name).read_text(encoding="utf-8")
        assert ("The store holds no rows" in text) == (kept == 0)


def test_the_failure_atlas_is_on_the_page(whole, rows):
    found = failure_atlas(rows)
    assert len(found.failures) > 3
    shown = whole[whole.index('id="atlas"') : whole.index('id="rules"')]
    for one in found.failures:
        assert f"<td>{escape(one.problem)}</td><td>{escape(one.accuracy)}</td>" in shown
        assert escape(one.cause) in shown
    assert found.causes().note in shown


def test_marked_times_are_explained_in_the_notes_of_their_tables_and_in_the_summary(whole):
    section = whole.partition("<caption>One run of each solver at similar accuracy</caption>")[2].partition("</p>")[0]
    assert re.search(r"<td>scipy\(method=Radau\)</td>.*?<td>[\d.]+ m?s\*</td>", section)
    assert "*: the process had to wait" in section
    assert "The median ratio of processor time to wall time of the timed solves is 0.90" in whole


def test_summary_holds_the_first_table_the_balance_the_failures_the_verdict_and_the_machine(report, rows):
    text = (report / "summary.md").read_text(encoding="utf-8")
    for part in (
        "## What to take",
        "## Wins and losses",
        "The one claim holds.",
        COMMAND,
        "cores 2",
    ):
        assert part in text
    content = content_of(rows)
    table = content.decisions["time", None]
    assert all(f"- {escape_text(sentence)}\n" in text for sentence in content.recommendations)
    assert all(escape_text(f"{cell.text} {cell.detail}") in text for line in table.rows for cell in line)
    assert failure_atlas(rows).causes().note in text


def test_summary_stays_below_200_lines_however_many_kinds_solvers_and_machines_there_are():
    rows = []
    for number, (m, p, tags) in enumerate(product((None, 0, 1), (0, 1), (None, (), ("stiff",), ("nonlinear reaction",)))):
        for solver in range(8):
            name, problem = f"s{number}x{solver}" if solver else "hht", f"p{number}"
            own = law(name, 1.0 + solver, 2, problem=problem, drift=1e-12)
            own.append(failed(name, 1e-7, problem=problem, environment={"python": f"{number}.{solver}"}))
            for row in own:
                row.metrics["system"] = {"n": 3, "m": m, "p": p, "tags": tags}
            rows += own
    text = summary_page(content_of(rows), COMMAND)
    assert 150 < text.count("\n") <= 200
    assert "more lines are on the page" in text


def test_bars_in_a_table_do_not_end_its_cells():
    header, rule, line = markdown_table(make_table(["max |g|", "b"], [["x | y", "*"]]))[0].splitlines()
    assert {text.replace("\\|", "").count("|") for text in (header, rule, line)} == {3}
