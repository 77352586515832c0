"""Evidence: claims with the number measured, the bound and the verdict, as table, JSON and curves.

``check`` and ``verify`` (later ``validate``) all return an :class:`Evidence`; its JSON is
``{schema, passed, rows: [{id, claim, measured, bound, passed}], environment}``.
"""

from __future__ import annotations

import json
import math
import platform
from dataclasses import dataclass, field
from datetime import UTC, datetime
from html import escape
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from tabulate import tabulate

from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.printing import Printed

SCHEMA = "hhtbench.evidence/1"
LIBRARIES = ("hhtbench", "numpy", "scipy", "jax", "jaxlib", "equinox")


@dataclass(frozen=True, kw_only=True)
class Row:
    """One claim with the measured value, its bound and the verdict."""

    id: str  #: short and stable, "5.1/q"
    claim: str  #: a sentence
    measured: str | float
    bound: str  #: the bound as a reader would say it, "2.00 +- 0.05"; "not judged" where nothing is
    passed: bool | None  #: None: printed beside the claims, not judged

    def __post_init__(self) -> None:
        if not isinstance(self.measured, str):  # NumPy's and JAX's scalars are not JSON
            object.__setattr__(self, "measured", float(self.measured))
        if self.passed is not None:
            object.__setattr__(self, "passed", bool(self.passed))


@dataclass(frozen=True, kw_only=True)
class Curve:
    """One curve of a plot: label, abscissae and ordinates."""

    label: str
    x: tuple[float, ...]
    y: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Plot:
    """A plot for the report: curves, titles, axis labels and scaling."""

    id: str
    title: str
    caption: str  #: what is seen and what it shows
    x_label: str  #: with unit
    y_label: str  #: with unit
    curves: tuple[Curve, ...]
    logarithmic: bool = True
    slope: float | None = None  #: slope of a guide line, for convergence plots


@dataclass(frozen=True, kw_only=True)
class Evidence(Printed):
    """Rows and plots of one check or verification; printed as a table with a closing line."""

    title: str
    rows: tuple[Row, ...]
    plots: tuple[Plot, ...] = ()
    seconds: float | None = None  #: wall time of the measurement
    environment: dict[str, str] = field(default_factory=lambda: environment())

    @property
    def passed(self) -> bool:
        """True when no judged row failed and at least one was judged."""
        judged = [row.passed for row in self.rows if row.passed is not None]
        return bool(judged) and all(judged)

    @property
    def summary(self) -> str:
        """The closing line: how many claims hold, which fail."""
        judged = [row for row in self.rows if row.passed is not None]
        failed = [row.id for row in judged if not row.passed]
        line = f"{self.title}: {len(judged) - len(failed)} of {len(judged)} claims hold"
        return f"{line}; failed: {', '.join(failed)}" if failed else line

    def __repr__(self) -> str:
        return f"<Evidence: {self.summary}>"

    def __str__(self) -> str:
        return f"{self.table()}\n\n{self.summary}"

    def _repr_html_(self) -> str:
        return f"{self.table('html')}<p>{escape(self.summary)}</p>"

    def table(self, style: str = "simple", width: int | None = None) -> str:
        """The rows as a text table: ``style`` as in tabulate (simple, github, html), lines fit ``width``."""
        verdict = {True: "ok", False: "FAIL", None: ""}
        body = [[r.id, verdict[r.passed], r.claim, _number(r.measured), r.bound] for r in self.rows]
        widths = None if width is None else _widths(body, width)
        headers = ["id", "", "claim", "measured", "bound"]
        return tabulate(body, headers=headers, tablefmt=style, disable_numparse=True, maxcolwidths=widths)

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON document as plain Python values; a number that is not finite is written as text."""
        rows = [
            {"id": r.id, "claim": r.claim, "measured": _json(r.measured), "bound": r.bound, "passed": r.passed}
            for r in self.rows
        ]
        return {"schema": SCHEMA, "title": self.title, "passed": self.passed, "rows": rows, "environment": self.environment}

    def write_json(self, path: str | Path) -> None:
        """Write :meth:`as_dict` to ``path``."""
        Path(path).write_text(json.dumps(self.as_dict(), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_evidence(path: str | Path) -> Evidence:
    """Read an :class:`Evidence` from a file of :meth:`Evidence.write_json`: claims and environment, without curves.

    Raises
    ------
    ProblemError
        The file cannot be read or holds no evidence of this schema.
    """
    try:
        found = json.loads(Path(path).read_text(encoding="utf-8"))
        if found["schema"] != SCHEMA:
            raise ProblemError(f"{path} has the schema {found['schema']}; expected {SCHEMA}. Verify again.")
        rows = tuple(Row(**row) for row in found["rows"])
        return Evidence(title=found["title"], rows=rows, environment=found["environment"])
    except OSError as error:
        raise ProblemError(f"{path} cannot be read: {error.strerror}.") from error
    except (KeyError, TypeError, json.JSONDecodeError) as error:
        raise ProblemError(f"{path} holds no evidence of the schema {SCHEMA}; verify again.") from error


def environment() -> dict[str, str]:
    """Return Python's, the machine's and the libraries' names and versions, and today's date (UTC)."""
    found = {"python": platform.python_version(), "machine": platform.machine(), "system": platform.system()}
    for library in LIBRARIES:
        try:
            found[library] = version(library)
        except PackageNotFoundError:
            found[library] = "not installed"
    return {**found, "date": datetime.now(UTC).strftime("%Y-%m-%d")}


def plain(value: Any) -> Any:
    """Convert ``value`` to JSON types: arrays to lists, NaN and infinity to null."""
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _widths(body: list[list[str]], width: int) -> list[int]:
    """Return the widths of the five columns of a table that fits ``width`` characters.

    The first two keep their natural width; the others share the rest in proportion to what they need.
    """
    needed = [max(len(row[i]) for row in body) for i in range(5)] if body else [1] * 5
    kept, others = [max(n, 4) for n in needed[:2]], needed[2:]
    left = max(width - sum(kept) - 8, 30)
    shares = [max(11, left * n // max(sum(others), 1)) for n in others]
    while sum(shares) > left:
        shares[shares.index(max(shares))] -= 1
    return [*kept, *(min(share, max(n, 8)) for share, n in zip(shares, others, strict=True))]


def _number(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"


def _json(value: str | float) -> str | float:
    return value if isinstance(value, str) or math.isfinite(value) else str(value)
