"""Print stored references and check whether a new computation reproduces them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from tabulate import tabulate

from hhtbench.campaign.reference.certify import certify
from hhtbench.campaign.reference.files import read_certificate
from hhtbench.campaign.reference.plan import Entry, registered_folder
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.evidence import Row


def recomputed(entry: Entry, folder: Path | None) -> list[Row]:
    """Certify an entry again and compare with the stored values: one row per quantity."""
    stored = read_certificate(folder_of(folder) / f"{entry.name}.json")
    again = certify(entry)
    if not np.array_equal(stored["t"], again.t):
        raise ProblemError(f"{entry.name}: the stored times are not those of the plan; build it again.")
    rows = []
    for name, values in stored["values"].items():
        size = np.max(np.abs(again.values[name] - values) / stored["scales"][name], axis=1)
        bar = stored["bars"][name] + again.bars[name]
        worst = int(np.argmax(size / bar))
        claim = f"{entry.name}: {name} computed again lies within the error bars"
        text = f"{bar[worst]:.1e} at t = {again.t[worst]:g} s"
        rows.append(
            Row(
                id=f"{entry.name}/{name}",
                claim=claim,
                measured=size[worst],
                bound=text,
                passed=bool(np.all(size <= bar) and np.all(np.isfinite(bar))),
            )
        )
    return rows


def text_of(stored: dict[str, Any]) -> str:
    """Format a stored certificate: digits, methods and error bars at the stated times."""
    heads = ["confirmed by", "form", "status", *(f"difference in {quantity}" for quantity in stored["values"])]
    rows = [
        [other["solver"], other["form"], other["status"], *(other["largest_difference"].get(q) for q in stored["values"])]
        for other in stored["confirmed_by"]
    ]
    stated = [int(np.argmin(np.abs(stored["t"] - t))) for t in stored["stated"]]
    bars = [[stored["t"][i], *(stored["bars"][quantity][i] for quantity in stored["bars"])] for i in stated]
    said = [f"{stored['spec']}: values of {stored['first']} at rtol {stored['rtol']:g}"]
    said += [stored["note"]] if stored["note"] else []
    said += ["\n" + tabulate(rows, headers=heads, floatfmt=".1e"), "\nscaled error bars at the stated times"]
    return "\n".join(
        [*said, tabulate(bars, headers=["t [s]", *stored["bars"]], floatfmt=["g", *[".1e"] * len(stored["bars"])])]
    )


def folder_of(folder: Path | None) -> Path:
    """Return ``folder``, or the library's own if None; raise if it does not exist."""
    if folder is not None and not folder.is_dir():
        raise ProblemError(f"there is no folder {folder} with references; build some with `hhtbench reference build`.")
    return registered_folder() if folder is None else folder
