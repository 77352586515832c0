"""``hhtbench study selection``: regret of the advice on held-out problems."""

from __future__ import annotations

import math
import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tabulate import tabulate

from hhtbench.advice.candidates import CANDIDATES, campaign_for
from hhtbench.advice.criteria import Criteria
from hhtbench.advice.database import ACCURACIES, HELD, Database, Scene, read_database, reduced, write_database
from hhtbench.advice.families import drawn
from hhtbench.advice.features import Probe, probe
from hhtbench.advice.regret import Line, judge
from hhtbench.campaign import run_campaign
from hhtbench.campaign.analysis.fronts import MEASURES
from hhtbench.campaign.campaign import Progress
from hhtbench.campaign.execute import machine_limits
from hhtbench.campaign.references import auto_references
from hhtbench.campaign.store import RunRow, Store, load_rows
from hhtbench.catalogue.registry import load_problem
from hhtbench.protocol.errors import ProblemError
from hhtbench.runtime.processes import worker_processes

RULES: dict[str, Any] = {  # rules of the campaign over the drawn scenes
    "accuracies": ACCURACIES,
    "refinements": 10,
    "repeats": 2,
    "counting": False,
    "reference": "auto",
}
REFERENCE_SECONDS = 8.0  # of each solve of a certificate
HELD_OUT: dict[str, Callable[[Scene, Scene], bool]] = {
    "problem": lambda one, other: one.spec == other.spec,
    "family": lambda one, other: one.family == other.family,
}


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """Regret of all policies for one measure and drift bound."""

    held_out: str  #: "problem" or "family"
    on: str
    drift: float | None
    lines: tuple[Line, ...]


@dataclass(frozen=True, kw_only=True)
class Study:
    """Result of :func:`study_selection`."""

    scenes: int
    families: int
    judgements: tuple[Judgement, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return asdict(self)

    def __str__(self) -> str:
        return "\n\n".join([f"{self.scenes} scenes of {self.families} families", *map(_table, self.judgements)])


def study_selection(
    *,
    store: Path | None = None,
    scenes: int | None = None,
    seconds: float = 1.0,
    jobs: int | None = None,
    database: Path | None = None,
    tell: Callable[[str], None] = lambda text: None,
    progress: Progress | None = None,
) -> Study:
    """Measure the regret of a database's advice; with ``scenes`` or ``store`` of one made from their rows.

    Parameters
    ----------
    store
        SQLite file of the rows; without ``scenes`` those that it holds are taken.
    scenes
        Number of random scenes to run, all families in turn; None: none.
    seconds
        Time of each solver on each scene [s].
    database
        File for the reduced rows, for ``select``; None: not written.
    tell
        Called with messages, one line each.
    progress
        Called with the part that is running, the number done and the number in all.

    Raises
    ------
    ProblemError
        There are no rows, or they are of fewer than three families.
    """
    if store is None and scenes is None:
        if database is not None:
            raise ProblemError("a database is made from rows: give --store with some, or --scenes to run.")
        return judged(read_database())
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "runs.sqlite" if store is None else store
        rows = _run(_evenly(drawn(), scenes), file, seconds, jobs, tell, progress) if scenes else load_rows(file)
    specs = list(dict.fromkeys(row.problem for row in rows))
    tell(f"computing the features of {len(specs)} problems")
    made = reduced(rows, probes_of(specs, jobs or 1, tell))
    if database is not None:
        write_database(made, database, f"hhtbench study selection --scenes {len(specs)} --store FILE --database FILE")
    return judged(made)


def _evenly(specs: Sequence[str], count: int) -> Sequence[str]:
    """Return ``count`` of the specs (or all) at equal distances, so that no family at the end is left out."""
    kept = min(count, len(specs))
    return [specs[index * len(specs) // kept] for index in range(kept)]


def judged(database: Database) -> Study:
    """Measure the regret with each problem, and each family, held out in turn."""
    families = {scene.family for scene in database.scenes}
    if len(families) < 3:
        raise ProblemError(f"scenes of at least three families are needed to hold one out; these are of {len(families)}.")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Mean of empty slice", RuntimeWarning)  # errors that nobody reaches have no vote
        found = [
            Judgement(held_out=name, on=on, drift=drift, lines=judge(database, _criteria(on, drift), same))
            for name, same in HELD_OUT.items()
            for on in MEASURES
            for drift in HELD
        ]
    return Study(scenes=len(database.scenes), families=len(families), judgements=tuple(found))


def _criteria(on: str, drift: float | None) -> Callable[[float], Criteria]:
    return lambda accuracy: Criteria(accuracies=(accuracy,), on=on, drift=drift)


def _run(
    specs: Sequence[str],
    file: Path,
    seconds: float,
    jobs: int | None,
    tell: Callable[[str], None],
    progress: Progress | None,
) -> tuple[RunRow, ...]:
    """Run the usual candidates on random scenes, as a campaign; cells in ``file`` are not run again."""
    campaign = campaign_for(specs, CANDIDATES, max_seconds=seconds / 2, pair_seconds=seconds, **RULES)
    limits = machine_limits(jobs)
    with Store(file) as rows:
        references = auto_references(campaign, file, limits.jobs, tell, REFERENCE_SECONDS)
        return run_campaign(campaign, rows, limits=limits, references=references, progress=progress).rows


def probes_of(specs: Sequence[str], jobs: int, tell: Callable[[str], None]) -> dict[str, Probe]:
    """Compute the features of each problem in worker processes; those that fail are reported by ``tell`` and left out."""
    found = {}
    with worker_processes(jobs) as pool:
        for spec, made in zip(specs, pool.map(_probed, specs), strict=True):
            if isinstance(made, str):
                tell(f"{spec}: {made}")
            else:
                found[spec] = made
    return found


def _probed(spec: str) -> Probe | str:
    warnings.simplefilter("ignore")
    try:
        return probe(load_problem(spec))
    except (ProblemError, TypeError) as error:
        return str(error)


def _answers(line: Line) -> str:
    """Format the share of answers, the share within twice the best, and the 95th percentile of the regret."""
    if math.isnan(line.right):
        return ""
    silent = "" if math.isnan(line.silent) else f"; the rest: {line.silent:.0%}, 95 % {line.silent_high:.2g}"
    return f"{line.spoken:.0%}: {line.right:.0%} within 2x, 95 % {line.right_high:.2g}{silent}"


def _table(judgement: Judgement) -> str:
    body = [
        [
            line.policy,
            f"{line.median:.2f}",
            f"{line.high:.3g}",
            f"{line.mean:.2f}",
            f"{line.twice:.0%}",
            f"{line.closed:.2f} ({line.interval[0]:.2f} to {line.interval[1]:.2f})",
            f"{line.gain[0]:.2f} to {line.gain[1]:.2f}",
            _answers(line),
        ]
        for line in judgement.lines
    ]
    held = "any drift" if judgement.drift is None else f"drift at most {judgement.drift:g}"
    heads = ["", "median", "95 %", "mean", "within 2x", "closed gap", "log regret over fixed, median", "answers"]
    title = f"{judgement.on}, {held}, every {judgement.held_out} held out in turn: regret\n"
    return title + tabulate(body, headers=heads, disable_numparse=True)
