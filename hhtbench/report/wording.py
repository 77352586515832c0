"""Sentences and groups that the Markdown and the HTML page share."""

from __future__ import annotations

import re
from collections.abc import Sequence

from hhtbench.protocol.evidence import Evidence, Row


def verdict(evidence: Evidence) -> str:
    """How many claims hold, and which fail."""
    judged = [row for row in evidence.rows if row.passed is not None]
    failed = [row.id for row in judged if not row.passed]
    if not judged:
        return "Nothing was judged, so nothing is shown."
    if failed:
        text = f"{len(failed)} of {len(judged)} claims {'fails' if len(failed) == 1 else 'fail'}: {', '.join(failed)}."
    else:
        text = f"All {len(judged)} claims hold." if len(judged) > 1 else "The one claim holds."
    beside = len(evidence.rows) - len(judged)
    return f"{text} {beside} further {'row is' if beside == 1 else 'rows are'} printed and not judged." if beside else text


def duration(seconds: float | None) -> str:
    """``12.3 s``, ``2.5 min``."""
    if seconds is None:
        return "not measured"
    return f"{seconds:.1f} s" if seconds < 120 else f"{seconds / 60:.1f} min"


def groups(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Rows by the part of their id before "/", in order of first appearance."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(group_of(row.id), []).append(row)
    return found


def group_of(identifier: str) -> str:
    """The part of an id before "/"."""
    return identifier.partition("/")[0]


def anchor(identifier: str) -> str:
    """The id as a fragment of an address: letters, digits and hyphens."""
    return "plot-" + re.sub(r"[^A-Za-z0-9]+", "-", identifier).strip("-").lower()
