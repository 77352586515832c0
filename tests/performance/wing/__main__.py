"""Tables of the wing from the rows of its campaign: ``python -m tests.performance.wing STORE PAGE.md``.

One table a problem: for every solver the least processor time at each error, interpolated between two runs, with drift and
error of the multipliers of the run at the middle error; then one table of all scenes, one of Exudyn, and the summary.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from tabulate import tabulate

from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.fronts import Front, campaign_of
from hhtbench.campaign.store import RunRow, load_rows
from hhtbench.report.words import seconds, shown
from tests.performance.wing.beside_exudyn import comparisons
from tests.performance.wing.verdicts import BEAMS, Verdict, by_scene, summary, verdicts

TARGETS = (1e-2, 1e-3, 1e-4)  # scaled errors of q and v
JUDGED = (1e-2, 1e-3)  # those of the summary


def table(head: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    return tabulate(body, headers=head, tablefmt="github", disable_numparse=True)


def of_problem(fronts: Sequence[Front]) -> str:
    """Return the table of one problem; ``fronts`` are those at ``TARGETS``."""
    costs = [{cost.entry: cost for cost in front.costs} for front in fronts]
    lines = []
    for entry in dict.fromkeys(entry for front in fronts for entry in front.entries):
        found = [cost.get(entry) for cost in costs]
        run = next((cost.run for cost in found[1:] + found[:1] if cost is not None), None)
        times = ["" if cost is None else f"{'<= ' if cost.bound else ''}{seconds(cost.value)}" for cost in found]
        drift = [] if run is None else [shown(run.position), shown(run.velocity), shown(run.lam)]
        why = next((front.missing[entry].text for front in fronts if entry in front.missing), "")
        lines.append([entry, *times, *(drift or 3 * [""]), why[:90]])
    heads = [*(f"{target:g}" for target in TARGETS), "position", "velocity", "multipliers", "not reached, because"]
    first = next((k for k, line in enumerate(lines) if line[1]), 0)
    return table([fronts[0].problem, *heads], sorted(lines[:first]) + lines[first:])


def pages(rows: Sequence[RunRow]) -> Iterator[str]:
    """Yield the parts of the page."""
    fronts = analysis.fronts(rows, "time", TARGETS)
    for problem in dict.fromkeys(front.problem for front in fronts):
        yield of_problem([front for front in fronts if front.problem == problem])
    ways = {"HHT": verdicts(rows, TARGETS), "HHT under error control": verdicts(rows, TARGETS, constant=False)}
    for target in JUDGED:
        yield of_scenes({who: by_scene(found, target) for who, found in ways.items()}, target)
    yield f"Repeats of one solve differ by up to a factor {campaign_of(rows).level:.3g}: costs within it are level."
    for target in JUDGED:
        for who, found in ways.items():
            yield f"Error {target:g}, {who}: {summary(by_scene(found, target))}"


def of_scenes(ways: Mapping[str, Mapping[str, Verdict]], target: float) -> str:
    """Return the table of all scenes at one error: who is the cheapest, and HHT's factors."""
    lines = []
    for scene in next(iter(ways.values())):
        found = [way[scene] for way in ways.values()]
        factors = [f"{'>= ' if one.bound else ''}{one.factor:.3g} ({one.outcome})" for one in found]
        lines.append(
            [
                scene + (" (beam)" if scene in BEAMS else ""),
                seconds(found[0].ours),
                found[0].winner,
                found[0].rival,
                *factors,
            ]
        )
    return table(
        [
            f"error {target:g}",
            "HHT",
            "cheapest of all",
            "best that is no alpha method",
            *(f"its factor over {who}" for who in ways),
        ],
        lines,
    )


def main(store: str, page: str) -> None:
    """Print the page and write it."""
    parts = [*pages(load_rows(store)), *comparisons()]
    text = "\n\n".join(parts)
    sys.stdout.write(f"{text}\n")
    Path(page).write_text(f"# HHT and its rivals on flexible, stiff and contact scenes\n\n{text}\n", encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:3])
