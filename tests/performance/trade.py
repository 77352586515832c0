"""What ``trade`` chooses in a minute, beside an exhaustive search: ``python -m tests.performance.trade``.

On mechanisms that the library does not have: every candidate at every error, each timed three times, says what the best is
and what the choice of the trade costs there.  Exits with 1 where a choice costs more than 1.3 times the best.
"""

from __future__ import annotations

import sys
import tempfile
import warnings
from pathlib import Path

import click
from tabulate import tabulate

import hhtbench as hb
from hhtbench.advice.candidates import CANDIDATES, campaign_for
from hhtbench.advice.trading import ACCURACIES
from hhtbench.campaign import analysis, run_campaign
from hhtbench.campaign.analysis.fronts import MEASURES
from hhtbench.campaign.execute import machine_limits
from hhtbench.campaign.references import auto_references
from hhtbench.campaign.store import RunRow, Store

SCENES = Path(__file__).parent.parent / "advice" / "mechanisms.py"
NAMES = ("press", "lorry")
SECONDS = 60.0
MOST = 1.3  # times the best of the exhaustive search


def exhaustive(spec: str, file: Path) -> tuple[RunRow, ...]:
    """All candidates at all errors, with five times the time that any needs."""
    campaign = campaign_for(
        [spec], CANDIDATES, accuracies=ACCURACIES, max_seconds=20.0, pair_seconds=60.0, counting=False, reference="auto"
    )
    limits = machine_limits()
    with Store(file) as rows:
        references = auto_references(campaign, file, limits.jobs, click.echo)
        return run_campaign(campaign, rows, limits=limits, references=references).rows


def compared(spec: str, on: str, rows: tuple[RunRow, ...], folder: Path) -> list[list[object]]:
    """A line an error: choice, best, and what the choice costs there over it."""
    found = hb.trade(spec, seconds=SECONDS, on=on, store=folder / f"{on}.sqlite")
    click.echo(f"{found}\n")
    fronts = {front.target: front for front in analysis.fronts(rows, on, ACCURACIES)}
    lines = []
    for choice in found.choices:
        front = fronts[choice.accuracy]
        costs = {cost.entry: cost.value for cost in front.costs}
        factor = costs.get(choice.best.entry, float("inf")) / front.costs[0].value
        lines.append(
            [spec.rpartition(":")[2], on, choice.accuracy, choice.best.entry, front.costs[0].entry, factor, found.seconds]
        )
    return lines


def main() -> int:
    """All mechanisms, by time and by evaluations."""
    warnings.simplefilter("ignore")
    lines = []
    for name in NAMES:
        spec = f"{SCENES}:{name}"
        with tempfile.TemporaryDirectory() as folder:
            rows = exhaustive(spec, Path(folder) / "all.sqlite")
            for on in MEASURES:
                lines += compared(spec, on, rows, Path(folder))
    click.echo(tabulate(lines, headers=["", "", "error", "choice", "best", "times the best", "seconds"], floatfmt=".3g"))
    return int(any(line[5] > MOST for line in lines))


if __name__ == "__main__":
    sys.exit(main())
