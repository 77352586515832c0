"""The report's page as a browser shows it: Debian's Chromium, without a window."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess

import pytest

from tests.report.synthetic import PROBLEMS, SOLVERS

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium: the page is not looked at")

WIDE, NARROW = 1280, 390
FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=20000", "--dump-dom"),
    *("--allow-file-access-from-files", "--disable-dev-shm-usage", "--hide-scrollbars"),
)
# Opens pages in frames, waits until all is drawn, and tells what it finds and does there.
FRAMES = """
<body><script type="module">
const told = {};
async function drawn(page) {
  while ([...page.querySelectorAll(".plot")].some(box => !box.dataset.drawn || !box.querySelector(".nsewdrag"))) {
    await new Promise(soon => setTimeout(soon, 50));
  }
}
async function opened(name, width) {
  const frame = document.createElement("iframe");
  frame.style = `width: ${width}px; height: 900px`;
  frame.src = name;
  document.body.append(frame);
  await new Promise(ready => frame.addEventListener("load", ready));
  await drawn(frame.contentDocument);
  return frame.contentDocument;
}
const widths = page => [...page.querySelectorAll(".plot .nsewdrag")].map(area => area.getBoundingClientRect().width);
try {
  LOOKING
} catch (error) {
  told.error = String(error.stack ?? error);
}
const result = document.createElement("pre");
result.id = "told";
result.textContent = JSON.stringify(told);
document.body.replaceChildren(result);
</script></body>
"""
COMPARISON = """
const texts = found => [...found].map(one => one.textContent);
const names = box => box.data.filter(trace => trace.visible).map(trace => trace.name);
const button = (page, words) => [...page.querySelectorAll("button")].find(one => one.textContent === words);

async function csv(figure) {
  const link = figure.querySelector("a.csv");
  link.addEventListener("click", event => event.preventDefault());
  link.click();
  return [link.download, await (await fetch(link.href)).text()];
}

  const wide = await opened("index.html", WIDE), narrow = await opened("index.html", NARROW);
  told.plots = wide.querySelectorAll(".plot").length;
  told.overflow = [wide, narrow].map(page => page.documentElement.scrollWidth);
  told.drawn = widths(narrow);
  const style = page => page.defaultView.getComputedStyle(page.body).backgroundColor;
  told.ground = style(wide);
  told.filter = wide.defaultView.getComputedStyle(wide.querySelector(".plot")).filter;

  const shown = () => [...wide.querySelectorAll("[data-table]")].filter(one => !one.hidden).map(one => one.dataset.table);
  told.table = [shown()];
  button(wide, "evaluations").click();
  button(wide, "≤ 1e-10").click();
  told.table.push(shown());

  const table = wide.querySelector("section:not(.decision) details table");
  const header = [...table.tHead.rows[0].cells].find(cell => cell.textContent === "its cost");
  const column = () => texts([...table.tBodies[0].rows].map(row => row.cells[header.cellIndex]));
  header.querySelector("button").click();
  told.sorted = [column(), header.ariaSort];
  header.querySelector("button").click();
  told.reversed = [column(), header.ariaSort];

  const figure = wide.getElementById("plot-andrews-work-and-precision"), box = figure.querySelector(".plot");
  told.views = texts(figure.querySelectorAll(".views button"));
  told.front = [...new Set(names(box))];
  button(wide, "all").click();
  await drawn(wide);
  told.all = [...new Set(names(box))];
  const label = () => box.layout.xaxis.title.text;
  told.label = [label()];
  figure.querySelectorAll(".views button")[2].click();
  told.label.push(label());
  told.captions = texts([...figure.querySelectorAll(".caption")].filter(one => !one.hidden));
  told.csv = await csv(figure);
  told.profile = await csv(wide.getElementById("plot-errors-reached-within-a-cost"));
"""


def looked_at(report, script, *flags):
    """What the script has told of the pages in the folder ``report``."""
    page = report / "looking.html"
    whole = FRAMES.replace("LOOKING", script).replace("WIDE", str(WIDE)).replace("NARROW", str(NARROW))
    page.write_text(whole, encoding="utf-8")
    command = [CHROMIUM, *FLAGS, *flags, page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    page.unlink()
    found = re.search(r'<pre id="told">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found, done.stderr[-2000:]
    told = json.loads(html.unescape(found[1]))
    assert "error" not in told, told["error"]
    return told


@pytest.fixture(scope="module")
def told(report):
    return looked_at(report, COMPARISON)


def test_every_figure_is_drawn(told):
    assert told["plots"] > 2 + 3 * len(PROBLEMS)
    assert len(told["drawn"]) == told["plots"]


def test_nothing_is_wider_than_a_telephone_and_plots_fill_three_fifths_of_it(told):
    assert told["overflow"] == [WIDE, NARROW]
    assert min(told["drawn"]) >= 0.6 * NARROW


def test_buttons_choose_the_table_of_a_measure_and_a_bound_of_the_drift(told):
    assert told["table"] == [["time any"], ["evaluations ≤ 1e-10"]]


def seconds(text):
    value, unit = text.replace("≤", "").replace("*", "").split()
    return float(value) * {"s": 1.0, "ms": 1e-3, "µs": 1e-6}[unit]


def test_a_click_on_a_header_sorts_numbers_with_their_units_and_another_one_turns_the_order(told):
    for (column, said), order in ((told["sorted"], "ascending"), (told["reversed"], "descending")):
        times = [seconds(text) for text in column if text.endswith("s")]
        assert said == order
        assert len(set(times)) > 3
        assert times == sorted(times, reverse=order == "descending")


def test_hht_and_the_pareto_front_are_shown_first_and_all_at_a_click(told):
    labels = {solver.replace("'", "") for solver in SOLVERS}
    assert {label for label in labels if label.startswith("hht")} < set(told["front"]) < labels
    assert set(told["all"]) == labels


def test_work_and_precision_switches_between_time_evaluations_and_drift(told):
    assert told["views"] == ["time", "evaluations", "drift"]
    assert told["label"] == ["processor time [s]", "largest scaled drift of position and velocity constraints"]
    (caption,) = told["captions"]
    assert "violation of the constraints" in caption


def test_data_of_the_view_come_as_csv(told, rows):
    name, text = told["csv"]
    lines = text.splitlines()
    assert name.startswith("plot-andrews-work-and-precision")
    assert name.endswith(".csv")
    assert lines[0] == '"curve","largest scaled drift of position and velocity constraints","scaled error of q, v","remark"'
    assert len(lines) == 1 + sum(row.problem == "andrews" and row.success for row in rows)
    _, profile = told["profile"]
    assert '"hht(alpha=0)",' in profile
    assert profile.splitlines()[0] == '"curve","processor time [s]","share reached","remark"'


def test_a_dark_page_has_a_dark_ground_and_figures_turned_round(report, told):
    assert (told["ground"], told["filter"]) == ("rgb(255, 255, 255)", "none")
    dark = looked_at(report, COMPARISON, "--blink-settings=preferredColorScheme=0")
    assert max(map(int, re.findall(r"\d+", dark["ground"]))) < 60
    assert dark["filter"] == "invert(1) hue-rotate(180deg)"
