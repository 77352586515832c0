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
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium: the page is not drawn")

WIDE, NARROW = 1280, 390
FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=20000", "--dump-dom"),
    *("--allow-file-access-from-files", "--disable-dev-shm-usage", "--hide-scrollbars"),
)
# Opens pages in frames, opens their parts, waits until all is drawn, and reports what it finds and does there.
FRAMES = """
<body><script type="module">
const found = {};
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
  const parts = [...frame.contentDocument.querySelectorAll("details.part")];
  for (const part of parts) part.open = true;
  while (parts.some(part => part.querySelector(":scope > script"))) await new Promise(soon => setTimeout(soon, 50));
  await new Promise(soon => setTimeout(soon, 200));
  await drawn(frame.contentDocument);
  return frame.contentDocument;
}
const widths = page => [...page.querySelectorAll(".plot .nsewdrag")].map(area => area.getBoundingClientRect().width);
try {
  ACTIONS
} catch (error) {
  found.error = String(error.stack ?? error);
}
const result = document.createElement("pre");
result.id = "found";
result.textContent = JSON.stringify(found);
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
  found.plots = wide.querySelectorAll(".plot").length;
  found.overflow = [wide, narrow].map(page => page.documentElement.scrollWidth);
  found.drawn = widths(narrow);
  const style = page => page.defaultView.getComputedStyle(page.body).backgroundColor;
  found.ground = style(wide);
  found.filter = wide.defaultView.getComputedStyle(wide.querySelector(".plot")).filter;

  const shown = () => [...wide.querySelectorAll("[data-table]")].filter(one => !one.hidden).map(one => one.dataset.table);
  found.table = [shown()];
  button(wide, "evaluations").click();
  button(wide, "≤ 1e-10").click();
  found.table.push(shown());

  const table = [...wide.querySelectorAll("details table")].find(one => one.caption?.textContent.startsWith("One run"));
  const header = [...table.tHead.rows[0].cells].find(cell => cell.textContent === "time");
  const column = () => texts([...table.tBodies[0].rows].map(row => row.cells[header.cellIndex]));
  header.querySelector("button").click();
  found.sorted = [column(), header.ariaSort];
  header.querySelector("button").click();
  found.reversed = [column(), header.ariaSort];

  const figure = wide.getElementById("plot-andrews-work-and-precision"), box = figure.querySelector(".plot");
  found.views = texts(figure.querySelectorAll(".views button"));
  found.front = [...new Set(names(box))];
  button(wide, "all").click();
  await drawn(wide);
  found.all = [...new Set(names(box))];
  const label = () => box.layout.xaxis.title.text;
  found.label = [label()];
  figure.querySelectorAll(".views button")[2].click();
  found.label.push(label());
  found.captions = texts([...figure.querySelectorAll(".caption")].filter(one => !one.hidden));
  found.csv = await csv(figure);
  found.profile = await csv(wide.getElementById("plot-errors-reached-within-a-cost"));
"""


def found_on(report, script, *flags):
    """What the script reports of the pages in the folder ``report``."""
    page = report / "frames.html"
    whole = FRAMES.replace("ACTIONS", script).replace("WIDE", str(WIDE)).replace("NARROW", str(NARROW))
    page.write_text(whole, encoding="utf-8")
    command = [CHROMIUM, *FLAGS, *flags, page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    page.unlink()
    result = re.search(r'<pre id="found">(.*?)</pre>', done.stdout, re.DOTALL)
    assert result, done.stderr[-2000:]
    found = json.loads(html.unescape(result[1]))
    assert "error" not in found, found["error"]
    return found


@pytest.fixture(scope="module")
def found(report):
    return found_on(report, COMPARISON)


def test_every_figure_is_drawn(found):
    assert found["plots"] > 2 + 3 * len(PROBLEMS)
    assert len(found["drawn"]) == found["plots"]


def test_nothing_is_wider_than_a_telephone_and_plots_fill_three_fifths_of_it(found):
    assert found["overflow"] == [WIDE, NARROW]
    assert min(found["drawn"]) >= 0.6 * NARROW


def test_buttons_choose_the_table_of_a_measure_and_a_bound_of_the_drift(found):
    assert found["table"] == [["time any"], ["evaluations ≤ 1e-10"]]


def seconds(text):
    value, unit = text.replace("≤", "").replace("*", "").split()
    return float(value) * {"s": 1.0, "ms": 1e-3, "µs": 1e-6}[unit]


def test_a_click_on_a_header_sorts_numbers_with_their_units_and_another_one_turns_the_order(found):
    for (column, said), order in ((found["sorted"], "ascending"), (found["reversed"], "descending")):
        times = [seconds(text) for text in column if text.endswith("s")]
        assert said == order
        assert len(set(times)) > 3
        assert times == sorted(times, reverse=order == "descending")


def test_hht_and_the_pareto_front_are_shown_first_and_all_at_a_click(found):
    labels = {solver.replace("'", "") for solver in SOLVERS}
    assert {label for label in labels if label.startswith("hht")} < set(found["front"]) < labels
    assert set(found["all"]) == labels


def test_work_and_precision_switches_between_time_evaluations_and_drift(found):
    assert found["views"] == ["time", "evaluations", "drift"]
    assert found["label"] == ["processor time [s]", "largest scaled drift of position and velocity constraints"]
    (caption,) = found["captions"]
    assert "violation of the constraints" in caption


def test_data_of_the_view_come_as_csv(found, rows):
    name, text = found["csv"]
    lines = text.splitlines()
    assert name.startswith("plot-andrews-work-and-precision")
    assert name.endswith(".csv")
    assert lines[0] == '"curve","largest scaled drift of position and velocity constraints","scaled error of q, v","note"'
    assert len(lines) == 1 + sum(row.problem == "andrews" and row.success for row in rows)
    _, profile = found["profile"]
    assert '"hht(alpha=0)",' in profile
    assert profile.splitlines()[0] == '"curve","processor time [s]","share reached","note"'


def test_a_dark_page_has_a_dark_ground_and_figures_turned_round(report, found):
    assert (found["ground"], found["filter"]) == ("rgb(255, 255, 255)", "none")
    dark = found_on(report, COMPARISON, "--blink-settings=preferredColorScheme=0")
    assert max(map(int, re.findall(r"\d+", dark["ground"]))) < 60
    assert dark["filter"] == "invert(1) hue-rotate(180deg)"
