"""Runs of one trade: rounds of campaigns with a growing time limit per solve (successive halving).

A candidate is dropped once it has failed or costs several times the cheapest at the same error, so that the time goes to
the others.  The campaign's refinement rule chooses the next run of a candidate and ends it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from hhtbench.advice.candidates import Candidate, campaign_for
from hhtbench.advice.criteria import Criteria
from hhtbench.advice.standing import SEVERAL, CostsSoFar
from hhtbench.campaign import run_campaign
from hhtbench.campaign.analysis.cells import entry_of
from hhtbench.campaign.campaign import Progress
from hhtbench.campaign.execute import WorkerPool
from hhtbench.campaign.store import RunRow, Store

FIRST_CAP = 1.0  # time limit of one solve [s] in the first round and the smallest ever: quick solves may have to wait
GROWTH = 4.0  # growth of the time limit from round to round
ROOM = 2.0  # factor on SEVERAL times the best: a solve beside other work takes longer than alone
BATCH = 2  # candidates a worker between two readings of the clock: none waits for the slowest of few
SOLVES = 4.0  # time limit of a candidate in a round, in solves of the longest kind
REFINEMENTS = 16  # most settings of one candidate
FINALISTS = 2.0  # candidates up to this ratio to the cheapest at some error are timed again
REPEATS = 3  # readings of each of their solves, where times decide
UNTRIED = "not tried: the time was up"


@dataclass
class Rounds:
    """Run candidates on one problem in rounds; ``rows`` and ``left_out`` grow."""

    problem: str
    criteria: Criteria
    store: Store
    pool: WorkerPool
    references: Mapping[str, Path]
    ends: float  #: time of the monotonic clock [s] after which no solve begins
    tell: Callable[[str], None]
    pace: Progress  #: called whenever a cell has ended
    rows: dict[str, RunRow] = field(default_factory=dict)  #: by key
    left_out: dict[str, str] = field(default_factory=dict)  #: entry -> why it was dropped

    def run(self, candidates: Sequence[Candidate]) -> None:
        """Run rounds until no candidate could improve, every error is reached, or the time is up."""
        live, cap, size = list(candidates), FIRST_CAP, BATCH * self.pool.limits.jobs
        while live:
            before, waiting = len(self.rows), list(live)
            while waiting and time.monotonic() < self.ends:
                batch, waiting = waiting[:size], waiting[size:]
                self._campaign(batch, self._cap(cap), timing=False)
                self._give_up(live)
            live = [one for one in live if self._could_show_more(one)]
            if waiting or len(self.rows) == before:
                break
            cap *= GROWTH
        run = {entry_of(row) for row in self.rows.values()}
        self.left_out |= {one.entry: UNTRIED for one in candidates if one.entry not in run}

    def time_again(self, candidates: Sequence[Candidate]) -> None:
        """Measure times alone on a core for the candidates within ``FINALISTS`` of the cheapest, to decide between them."""
        fronts = self.places().fronts
        near = {cost.entry for front in fronts for cost in front.costs if cost.value <= FINALISTS * front.costs[0].value}
        chosen = [one for one in candidates if one.entry in near]
        if chosen:
            self.tell(f"timing {', '.join(one.entry for one in chosen)}")
            self._campaign(chosen, self._cap(FIRST_CAP), timing=True)

    def places(self) -> CostsSoFar:
        """Return the :class:`CostsSoFar` from all rows so far."""
        return CostsSoFar.of(tuple(self.rows.values()), self.criteria)

    def _campaign(self, batch: Sequence[Candidate], seconds: float, *, timing: bool) -> None:
        campaign = campaign_for(
            [self.problem],
            batch,
            accuracies=self.criteria.accuracies,
            refinements=REFINEMENTS,
            max_seconds=seconds,
            pair_seconds=SOLVES * seconds,
            repeats=REPEATS if self.criteria.on == "time" else 1,
            counting=False,
        )
        done = run_campaign(
            campaign,
            self.store,
            limits=self.pool.limits,
            executor=self.pool,
            references=self.references,
            timing=timing,
            progress=self.pace,
        )
        self.rows |= {row.key: row for row in done.rows}

    def _cap(self, cap: float) -> float:
        """Return the time limit of one solve [s]: little more than several times the best cost, and no more than the time
        left.
        """
        best = self.places().best() if self.criteria.on == "time" else None
        if best is not None:
            cap = max(FIRST_CAP, min(cap, ROOM * SEVERAL * best))
        return min(cap, max(FIRST_CAP, self.ends - time.monotonic()))

    def _give_up(self, live: Sequence[Candidate]) -> None:
        places = self.places()
        for one in live:
            why = places.hopeless(one.entry)
            if why and one.entry not in self.left_out:
                self.left_out[one.entry] = why
                self.tell(f"{one.entry} is dropped: {why}")

    def _could_show_more(self, one: Candidate) -> bool:
        return one.entry not in self.left_out and self.places().unfinished(one.entry)
