"""Reference files: JSON with every value as the shortest decimal that gives the same double, and the bars."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from hhtbench.errors import ProblemError
from hhtbench.evidence import environment
from hhtbench.reference.certify import Certificate

SCHEMA = "hhtbench.reference/1"


def write_certificate(certificate: Certificate, folder: Path) -> Path:
    """Write ``<name>.json``; the file is replaced only as a whole."""
    entry = certificate.entry
    stored: dict[str, Any] = {
        "schema": SCHEMA,
        "spec": entry.spec,
        "note": entry.note,
        "stated": list(entry.times),
        "t": certificate.t.tolist(),
        "values": {name: rows.tolist() for name, rows in certificate.values.items()},
        "scales": {name: size.tolist() for name, size in certificate.scales.items()},
        "bars": {name: [float(f"{bar:.1e}") for bar in bars] for name, bars in certificate.bars.items()},
        "first": entry.first,
        "rtol": entry.rtol,
        "confirmed_by": [
            {
                "solver": other.solver,
                "form": other.form,
                "independent": other.independent,
                "status": other.status,
                "largest_difference": {name: float(f"{np.max(d):.2e}") for name, d in other.difference.items()},
            }
            for other in certificate.confirmations
        ],
        "environment": environment(),
    }
    file = folder / f"{entry.name}.json"
    beside = file.with_suffix(".part")
    beside.write_text(
        json.dumps(stored, indent=None, separators=(",", ":")).replace("],[", "],\n[") + "\n", encoding="utf-8"
    )
    beside.replace(file)
    return file


def read_certificate(file: Path) -> dict[str, Any]:
    """The stored file, its numbers as arrays.

    Raises
    ------
    ProblemError
        There is no such file, or it is not a reference file.
    """
    try:
        stored = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, json.JSONDecodeError) as error:
        raise ProblemError(f"the reference {file.name} cannot be read: {error}.") from error
    if not isinstance(stored, dict) or stored.get("schema") != SCHEMA:
        raise ProblemError(f"{file.name} is not a reference file ({SCHEMA}); build it with `hhtbench reference build`.")
    for key in ("values", "scales", "bars"):
        stored[key] = {name: np.array(rows, dtype=np.float64) for name, rows in stored[key].items()}
    stored["t"] = np.array(stored["t"], dtype=np.float64)
    return stored
