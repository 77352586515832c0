"""The page's script without a browser: node runs it on the few elements that it asks for."""

from __future__ import annotations

import json
import re
import shutil
import subprocess

import pytest

from tests.report.drawings import PACKED, figures_of, scripts_of

NODE = shutil.which("node")
pytestmark = pytest.mark.skipif(NODE is None, reason="no node: the script is not run")

STUB = """
const drawn = [], files = [];
class Element {
  constructor(fields = {}) { Object.assign(this, {dataset: {}, listeners: {}, children: [], clientWidth: 600}, fields); }
  get plots() {
    this.made ??= [...(this.innerHTML ?? "").matchAll(/class="plot" data-figure="(\\d+)"/g)].map(
      found => new Element({dataset: {figure: found[1]}}));
    return this.made;
  }
  querySelectorAll(selector) {
    return selector === ".plot" ? [...this.plots, ...this.children.flatMap(one => one.plots)] : [];
  }
  querySelector(selector) { return selector === ":scope > script" ? this.script : null; }
  addEventListener(name, act) { this.listeners[name] = act; }
  setAttribute() {}
  closest() { return null; }
  append(child) { this.children.push(child); }
  after(link) { this.link = link; }
  remove() { this.parent.script = null; }
}
const packed = PACKED;
const root = new Element({innerHTML: BODY});
const parts = packed.filter(one => !one[0]).map(one => {
  const part = new Element();
  part.script = new Element({textContent: one[1], parent: part});
  return part;
});
globalThis.document = new Element({
  head: new Element(),
  createElement: () => new Element(),
  getElementById: id => new Element({textContent: packed.find(one => one[0] === id)[1]}),
  querySelectorAll: selector => selector === "details.part" ? parts
    : selector === ".plot" ? [root, ...parts].flatMap(one => one.querySelectorAll(selector)) : [],
});
globalThis.Plotly = {react: (box, data) => drawn.push([box.dataset.figure, data.length])};
globalThis.IntersectionObserver = class { observe() {} unobserve() {} disconnect() {} };
globalThis.addEventListener = () => {};
globalThis.location = {hash: ""};
URL.createObjectURL = blob => files.push(blob);
"""
ACTIONS = """
const soon = () => new Promise(done => setTimeout(done, 1500));
await soon();
const first = drawn.splice(0).map(one => one[0]);
parts[OPENED].open = true;
await parts[OPENED].listeners.toggle();
await soon();
const [box] = parts[OPENED].querySelectorAll(".plot");
box.link.listeners.click();
const keys = ["\N{LESS-THAN OR EQUAL TO} 3 ms", "2 s", "\N{ALMOST EQUAL TO} 4\N{MULTIPLICATION SIGN}",
  "1,200\N{MULTIPLICATION SIGN}", "hht"];
console.log(JSON.stringify({
  first, second: drawn.map(one => one[0]), csv: await files[0].text(), figure: box.dataset.figure,
  left: parts[OPENED].script,
  keys: keys.map(textContent => sortKey({textContent}).slice(0, 2)),
}));
process.exit(0);
"""


@pytest.fixture(scope="module")
def found(page, tmp_path_factory):
    body = PACKED.sub("", page.partition("<body>")[2].partition('<script type="module">')[0])
    script = re.search(r'<script type="module">(.*?)</script>', page, re.DOTALL)[1]
    parts = [json.loads(text) for name, text in scripts_of(page) if not name]
    actions = ACTIONS.replace("OPENED", str(next(index for index, part in enumerate(parts) if part["figures"])))
    stub = STUB.replace("PACKED", json.dumps(PACKED.findall(page))).replace("BODY", json.dumps(body))
    file = tmp_path_factory.mktemp("script") / "page.mjs"
    file.write_text(stub + script + actions, encoding="utf-8")
    done = subprocess.run([NODE, str(file)], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)


def test_only_the_first_figures_are_drawn_until_a_part_is_opened(page, found):
    assert len(found["first"]) == 2
    assert found["left"] is None
    assert {found["figure"]} | set(found["first"]) < set(found["second"])
    assert len(figures_of(page)) > 5 * len(found["second"])


def test_the_data_of_a_figure_in_a_part_come_as_csv(page, found):
    header, *lines = found["csv"].splitlines()
    drawn = figures_of(page)[int(found["figure"])]
    assert header == '"curve","processor time [s]","scaled error of q, v","note"'
    assert len(lines) == sum(len(trace["x"]) for trace in drawn["data"])
    assert any("rtol 1e-03; error" in line for line in lines)


def test_signs_and_units_before_and_after_a_number_do_not_hide_its_size(found):
    assert found["keys"] == [[0, pytest.approx(0.003)], [0, 2], [0, 4], [0, 1200], [1, 0]]
