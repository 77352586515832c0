"""Reference solution of a trade: the problem's own, or a certificate made for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from hhtbench.campaign import Campaign
from hhtbench.campaign.reference import reference_of
from hhtbench.campaign.references import auto_references
from hhtbench.protocol.problem import Problem


@dataclass(frozen=True)
class Truth:
    """Description and files of the reference solution."""

    text: str
    references: dict[str, Path] = field(default_factory=dict)  #: for :func:`~hhtbench.campaign.run_campaign`
    missing: str = ""  #: why nothing is known


def truth_of(
    problem: Problem, campaign: Campaign, store: Path, jobs: int, seconds: float, tell: Callable[[str], None]
) -> Truth:
    """Find or make the reference: closed solution, the problem's own reference, or a certificate by two method families.

    Each solve of a certificate may take ``seconds`` [s]; it is stored beside ``store`` and not made twice.
    """
    if problem.exact is not None:
        return Truth("the closed solution")
    if problem.reference is not None:
        return Truth(f"the problem's own reference{_digits(problem.reference.get('digits'))}")
    tell("making a reference: two families, two forms")
    said: list[str] = []
    found = auto_references(campaign, store, jobs, said.append, seconds)
    if not found:
        return Truth("nothing", missing=f"{'; '.join(said).rstrip('.') or 'none was made'}.")
    reference = reference_of(next(iter(found.values())))
    bar = max(float(reference["bars"][name].max()) for name in ("q", "v"))
    return Truth(f"{reference['source']}, error bar {bar:.1e}", found)


def _digits(digits: int | None) -> str:
    return "" if digits is None else f" ({digits} digits)"
