"""References of ``--reference auto``: which problems of a campaign to certify, and the files of their certificates."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

from hhtbench.campaign.plan import Campaign
from hhtbench.campaign.reference import certified
from hhtbench.campaign.reference.auto import SECONDS, file_of
from hhtbench.campaign.sources import SourceReader
from hhtbench.catalogue.specs import canonical, parse_spec

#: solvers of certificates; with a problem's files they make a certificate's name
RESTS_ON = ("collocation", "projected", "cvode", "ida")
JUDGE = ("judge", "between", "reactions", "motion", "flow", "allowed", "repeated")  # modules that judge runs of campaigns
#: what measures a run does not change the truth
NOT_THESE = (
    *("hhtbench.campaign.", "hhtbench.campaign.analysis.", "hhtbench.checks.drift"),
    *(f"hhtbench.checks.result.{name}" for name in JUDGE),
)


def auto_references(
    campaign: Campaign, store: Path, jobs: int, tell: Callable[[str], None], seconds: float = SECONDS
) -> dict[str, Path]:
    """Certify the problems without exact solution or reference; returns problem -> file in ``<store>.references``.

    Each solve of a certificate may take ``seconds`` [s]; ``tell`` receives messages on what was not certified.
    """
    if campaign.reference != "auto":
        return {}
    files, _ = certified(_digests(campaign), _folder(store), jobs, tell, seconds)
    return files


def references_there(campaign: Campaign, store: Path) -> dict[str, Path]:
    """Return those files of :func:`auto_references` that exist already; none is made."""
    if campaign.reference != "auto":
        return {}
    files = {spec: file_of(digest, _folder(store)) for spec, digest in _digests(campaign).items()}
    return {spec: file for spec, file in files.items() if file.is_file()}


def _folder(store: Path) -> Path:
    return store.with_name(f"{store.name}.references")


def _digests(campaign: Campaign) -> dict[str, str]:
    reader = SourceReader()
    specs = dict.fromkeys(canonical(text) for grid in campaign.grids for text in grid.problems)
    return {spec: _digest(spec, reader) for spec in specs}


def _digest(spec: str, reader: SourceReader) -> str:
    behind = [reader.behind(parse_spec(spec), parse_spec(solver)) for solver in RESTS_ON]
    kept = [{name: value for name, value in found.items() if not name.startswith(NOT_THESE)} for found in behind]
    return hashlib.sha256(json.dumps([spec, kept], sort_keys=True).encode()).hexdigest()
