"""Reference files: JSON with every value as the shortest decimal that gives the same double, and the error bars."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from hhtbench.campaign.reference.certify import Certificate
from hhtbench.protocol.errors import ProblemError, did_you_mean
from hhtbench.protocol.evidence import environment

SCHEMA = "hhtbench.reference/1"


def write_certificate(certificate: Certificate, folder: Path) -> Path:
    """Write ``<name>.json`` atomically; returns its path."""
    entry = certificate.entry
    stored: dict[str, Any] = {
        "schema": SCHEMA,
        "spec": entry.spec,
        "note": entry.note,
        "stated": list(entry.times),
        "t": certificate.t.tolist(),
        "values": {name: rows.tolist() for name, rows in certificate.values.items()},
        "scales": {name: size.tolist() for name, size in certificate.scales.items()},
        "bars": {name: [_rounded_up(bar) for bar in bars] for name, bars in certificate.bars.items()},
        "first": entry.first,
        "rtol": entry.rtol,
        "jumps": list(certificate.jumps),
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


def _rounded_up(bar: float) -> float:
    """Round an error bar up to two significant digits."""
    if not math.isfinite(bar) or bar <= 0:
        return bar
    unit = 10.0 ** (math.floor(math.log10(bar)) - 1)
    return float(f"{math.ceil(bar / unit * (1 - 1e-12)) * unit:.1e}")


def read_certificate(file: Path) -> dict[str, Any]:
    """Read a reference file, with its numbers as arrays.

    Raises
    ------
    ProblemError
        There is no such file, or it is not a reference file.
    """
    known = sorted(other.stem for other in file.parent.glob("*.json")) if not file.is_file() else []
    if known:
        raise ProblemError(f"there is no reference {file.stem}.{did_you_mean(file.stem, known)} Stored: {', '.join(known)}.")
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
