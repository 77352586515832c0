"""``hhtbench.trade``: measure what an error costs on one's own problem with each solver, within a stated time."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tabulate import tabulate

from hhtbench.advice.candidates import CANDIDATES, Candidate, campaign_for
from hhtbench.advice.criteria import Criteria
from hhtbench.advice.database import read_database
from hhtbench.advice.features import probe
from hhtbench.advice.nearest import Space, expected
from hhtbench.advice.page import write_page
from hhtbench.advice.rounds import UNTRIED, Rounds
from hhtbench.advice.truth import truth_of
from hhtbench.advice.verdict import Choice, as_run, choices_of, failure, sentence
from hhtbench.campaign.analysis.fronts import Front
from hhtbench.campaign.asked import refuse_misspelt
from hhtbench.campaign.campaign import Progress
from hhtbench.campaign.execute import WorkerPool, machine_limits
from hhtbench.campaign.objects import Named, ThisProcess, named
from hhtbench.campaign.store import RunRow, Store
from hhtbench.catalogue.registry import holding, load_problem, load_solver
from hhtbench.catalogue.specs import canonical
from hhtbench.protocol.arguments import positive_integer, real_number
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.printing import Printed
from hhtbench.protocol.problem import Problem
from hhtbench.report.words import work
from hhtbench.solution.request import Request

ACCURACIES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
SECONDS = 60.0
REFERENCE_SHARE = 0.25  # time limit of each solve of the reference, over the seconds
LAST_SHARE = 0.85  # share of the seconds after which no candidate begins: the rest is for timing the cheapest


@dataclass(frozen=True, kw_only=True)
class Trade(Printed):
    """Result of :func:`trade`: costs at each error, and the recommendation."""

    problem: str  #: canonical spec
    criteria: Criteria
    reference: str  #: what errors are measured against
    unknown: str  #: why they are measured against nothing, or ""
    rows: tuple[RunRow, ...]  #: one a solve, as those of a campaign
    fronts: tuple[Front, ...]  #: at every error, the loosest first, what the runs took that reach it
    left_out: dict[str, str]  #: entry -> why it was dropped
    seconds: float  #: what it took [s]
    note: str = ""  #: on errors of a problem without scales

    @property
    def choices(self) -> tuple[Choice, ...]:
        """The cheapest solver and the next one at every error that a candidate reaches."""
        return choices_of(self.fronts)

    @property
    def sentence(self) -> str:
        """The solver to take, or what each candidate reported if none reaches an error."""
        found = sentence(self.fronts, self.criteria)
        if not found:
            ends = [row.status for row in self.rows] or ([] if self.unknown else ["untried"])
            return failure(self._said(), ends, self.unknown)
        untried = sum(why == UNTRIED for why in self.left_out.values())
        found = f"{found[:-1]}; {untried} candidates were not tried: give more seconds." if untried else found
        return f"{found} {self.note}".rstrip()

    def _said(self) -> dict[str, str]:
        """Return the reasons of the candidates without a cost."""
        return self.left_out | {entry: why.text for front in self.fronts for entry, why in front.missing.items()}

    def write_page(self, file: str | Path) -> None:
        """Write error against time, evaluations and drift, the table and the sentence as one self-contained HTML file."""
        write_page(self.rows, f"Trade on {self.problem}", self.sentence, self._table(), Path(file))

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        names = ("problem", "sentence", "reference", "unknown", "left_out", "seconds")
        choices = [choice.as_dict() for choice in self.choices]
        return {**{name: getattr(self, name) for name in names}, **asdict(self.criteria), "choices": choices}

    def __repr__(self) -> str:
        return f"<Trade on {self.problem}: {self.sentence}>"

    def __str__(self) -> str:
        return f"{self._table()}\n\n{self.sentence}"

    def _table(self) -> str:
        """Format costs by candidate and error; dropped candidates with the reason."""
        costs: dict[str, dict[float, str]] = {}
        for front in self.fronts:
            for cost in front.costs:
                costs.setdefault(cost.entry, {})[front.target] = work(cost.value, self.criteria.on)
        why = {entry: self.left_out.get(entry, "") for entry in costs}
        why |= {entry: text for entry, text in self._said().items() if entry not in costs}
        targets = [front.target for front in self.fronts]
        body = [[entry, *(costs.get(entry, {}).get(x, "") for x in targets), text] for entry, text in why.items()]
        heads = ["", *(f"{target:g}" for target in targets), "dropped or not reached"]
        title = f"{self.problem}: {self.criteria.on} to an error; errors against {self.reference}; {self.seconds:.0f} s\n\n"
        return title + tabulate(body, headers=heads, disable_numparse=True, maxcolwidths=[None] * (len(heads) - 1) + [40])


def trade(
    problem: str | Problem,
    *,
    accuracies: Sequence[float] = ACCURACIES,
    seconds: float = SECONDS,
    drift: float | None = None,
    on: str = "time",
    solvers: Sequence[str] | str = (),
    store: str | Path | None = None,
    jobs: int | None = None,
    tell: Callable[[str], None] = lambda text: None,
    progress: Progress = lambda part, done, total: None,
) -> Trade:
    """Measure on one problem which solver reaches given errors most cheaply.

    Parameters
    ----------
    problem
        A spec, ``planar_chain(n_links=5)`` or ``my.py:problem``, or a Problem: if no imported file holds it, all is
        solved in this process, without ``store``, and a warning says so.
    accuracies
        Errors of q and v to reach, scaled by the problem's scales, largest over the compared times.
    seconds
        Approximate time [s]: no candidate begins after 85 % of it; code that is being compiled is finished.
    drift
        Largest scaled drift of position and velocity constraints; None: any.
    on
        What to minimise: "time" or "evaluations".
    solvers
        Specs instead of the usual candidates; each runs with tolerances, or with constant steps if it takes none.
    store
        SQLite file that keeps the rows, for ``select`` and ``report``; None: nothing is kept.
    jobs
        Worker processes; None: one per core.
    tell
        Called with a line on each stage.
    progress
        Called with the seconds that have passed, as ``("seconds", 12, 60)``.

    Returns
    -------
    Trade
        Its ``sentence`` states the solver to take.

    Raises
    ------
    NotFoundError, ProblemError, TypeError
        Wrong use, before anything runs.
    """
    criteria = Criteria(accuracies=accuracies, on=on, drift=drift)
    found = named([problem], store=store)
    with holding(found.held):
        return _traded(found, criteria, solvers, seconds=seconds, store=store, jobs=jobs, tell=tell, progress=progress)


def _traded(
    found: Named,
    criteria: Criteria,
    solvers: Sequence[str] | str,
    *,
    seconds: float,
    store: str | Path | None,
    jobs: int | None,
    tell: Callable[[str], None],
    progress: Progress,
) -> Trade:
    """Make a reference, run the rounds, and time the candidates that may be the cheapest."""
    began = time.monotonic()
    if real_number("seconds", seconds) <= 0.0:
        raise ProblemError(f"seconds must be above 0; got {seconds:g}.")
    loaded, spec = load_problem(found.specs[0]), canonical(found.specs[0])
    candidates = _named(solvers, loaded) or in_expected_order(loaded, criteria)
    limits = machine_limits(None if jobs is None else positive_integer("jobs", jobs))
    pace = pace_of(began, seconds, progress)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "runs.sqlite" if store is None else Path(store)
        plan = campaign_for([spec], candidates, accuracies=criteria.accuracies, reference="auto")
        with Store(file) as rows, ThisProcess() if found.held else WorkerPool(limits) as pool:
            truth = truth_of(loaded, plan, file, 0 if found.held else limits.jobs, REFERENCE_SHARE * seconds, tell)
            rounds = Rounds(spec, criteria, rows, pool, truth.references, began + LAST_SHARE * seconds, tell, pace)
            rounds.run(candidates)  # without a reference too: their messages say what is wrong
            rounds.time_again(candidates)
    return Trade(
        problem=spec,
        criteria=criteria,
        reference=truth.text,
        unknown=truth.missing,
        rows=tuple(rounds.rows.values()),
        fronts=as_run(rounds.places().fronts),
        left_out=rounds.left_out,
        seconds=time.monotonic() - began,
        note=f"{loaded.note_on_scales} {found.note}".strip(),
    )


def pace_of(began: float, seconds: float, progress: Progress) -> Progress:
    """Return a callback that reports the seconds passed since ``began``, at most ``seconds``, to ``progress``."""
    total = max(1, math.ceil(seconds))
    return lambda *_: progress("seconds", min(int(time.monotonic() - began), total), total)


def in_expected_order(problem: Problem, criteria: Criteria) -> tuple[Candidate, ...]:
    """Order the usual candidates by expected cost; by the rule of thumb if none can be expected.

    Times of another machine are good enough for an order.
    """
    try:
        database = read_database()
        order = [entry for entry, _ in expected(database, Space.of(database), probe(problem).features, criteria).order]
    except Exception:  # noqa: BLE001 - a user's functions: what is wrong with them the runs tell
        return CANDIDATES
    return tuple(sorted(CANDIDATES, key=lambda one: order.index(one.entry) if one.entry in order else len(order)))


def _named(solvers: Sequence[str] | str, problem: Problem) -> tuple[Candidate, ...]:
    """Return the named solvers as candidates, with tolerances, or with constant steps if they refuse tolerances."""
    some = (solvers,) if isinstance(solvers, str) else tuple(solvers)
    refuse_misspelt(some)
    return tuple(Candidate(spec, "steps" if _takes_steps_only(spec, problem) else "rtol") for spec in dict.fromkeys(some))


def _takes_steps_only(spec: str, problem: Problem) -> bool:
    try:
        solver = load_solver(spec)
        return solver.accepts(problem, Request(rtol=1e-3)) is not None and solver.accepts(problem, Request(steps=10)) is None
    except Exception:  # noqa: BLE001 - the plugin's own: its run reports it
        return False
