"""Candidate solvers: one or two of every kind, in the order of a rule of thumb."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from hhtbench.campaign import Campaign, Grid
from hhtbench.campaign.analysis.cells import CONSTANT
from hhtbench.catalogue.specs import canonical


@dataclass(frozen=True)
class Candidate:
    """A solver with its options, and what is refined to reach an error."""

    spec: str
    refine: Literal["rtol", "steps"] = "rtol"

    @property
    def entry(self) -> str:
        """Name of its curve in the analysis (:func:`hhtbench.campaign.analysis.cells.entry_of`)."""
        name = canonical(self.spec).replace("'", "").replace('"', "")
        return name if self.refine == "rtol" else name + CONSTANT


CANDIDATES = (  # first the smooth, then what holds constraints, then the stiff: the order where nothing else is known
    Candidate("projected(method=DOP853)"),
    Candidate("hht(alpha=-0.05)"),
    Candidate("cvode(form=ode, method=adams)"),
    Candidate("ida(form=index1)"),
    Candidate("hht(alpha=-0.05)", "steps"),
    Candidate("scipy(method=DOP853)"),
    Candidate("cvode(form=ode, method=bdf)"),
    Candidate("ida(form=ggl)"),
    Candidate("scipy(method=LSODA)"),
    Candidate("scipy(method=Radau)"),
    Candidate("collocation(form=ggl)"),
)  # diffrax compiles for ten seconds before its first step and was never the cheapest; name it in ``solvers``


def campaign_for(problems: Sequence[str], candidates: Iterable[Candidate], **fields: object) -> Campaign:
    """Return a campaign of ``candidates`` on ``problems``; ``fields`` are further fields of Campaign."""
    chosen = list(candidates)
    grids = tuple(
        Grid(problems=tuple(problems), solvers=solvers, refine=refine)
        for refine in ("rtol", "steps")
        if (solvers := tuple(one.spec for one in chosen if one.refine == refine))
    )
    return Campaign(grids=grids, **fields)  # type: ignore[arg-type]
