"""Build certified references and write their files."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any

from hhtbench.campaign.reference.certify import Certificate, certify
from hhtbench.campaign.reference.files import write_certificate
from hhtbench.campaign.reference.plan import Entry
from hhtbench.runtime.processes import worker_processes
from hhtbench.runtime.progress import Bar, Lines


def build(entries: Sequence[Entry], folder: Path, jobs: int, shown: Lines | Bar) -> list[dict[str, Any]]:
    """Write the certificates of ``entries`` into ``folder``; return name, digits and outcome of each as plain values."""
    folder.mkdir(parents=True, exist_ok=True)
    built: list[dict[str, Any]] = []
    with worker_processes(jobs, fresh=True) as pool:
        waiting = {pool.submit(certify, entry): entry for entry in entries}
        shown.advance("references", 0, len(waiting))
        for done in as_completed(waiting):
            entry, error = waiting[done], done.exception()
            if error is not None:
                text = f"{type(error).__name__}: {error}"
                built.append({"name": entry.name, "certified": False, "error": text})
                shown.say(f"{entry.name}: {text}")
            else:
                certificate = done.result()
                built.append(_facts(certificate, str(write_certificate(certificate, folder))))
                shown.show(line_of(certificate))
            shown.advance("references", len(built), len(waiting))
    return built


def _facts(certificate: Certificate, file: str) -> dict[str, Any]:
    digits = {name: certificate.digits(name) for name in certificate.values}
    return {"name": certificate.entry.name, "certified": certificate.certified, "digits": digits, "file": file}


def line_of(certificate: Certificate) -> str:
    """Format a certificate's digits and the outcomes of its confirmations as one line."""
    digits: dict[str, Any] = {name: f"{certificate.digits(name):.1f}" for name in certificate.values}
    text = ", ".join(f"{name} {count}" for name, count in digits.items())
    ended = "; ".join(f"{other.solver} {other.status} in {other.seconds:.1f} s" for other in certificate.confirmations)
    verdict = "" if certificate.certified else "NOT CERTIFIED: no independent solver confirms it. "
    return f"{certificate.entry.name}: {verdict}digits: {text} ({ended})"
