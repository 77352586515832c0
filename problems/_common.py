"""Helpers of the problem files: range checks, stored reference values, minimal coordinates, options of mechanisms."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hhtbench.protocol.arguments import real_number
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import MinimalCoordinates

REFERENCES = Path(__file__).with_name("references")


def checked(
    name: str, value: Any, *, above: float = -np.inf, at_least: float = -np.inf, below: float = np.inf, unit: str
) -> float:
    """Return ``value`` as a float if it lies in the stated range.

    Raises
    ------
    ProblemError
        Outside the range; the text names the parameter, the range and what came.
    TypeError
        Not a real number.
    """
    number = real_number(name, value, unit=f" [{unit}]")
    if number > above and number >= at_least and number < below:
        return number
    limits = [f"above {above:g}"] if above > -np.inf else []
    limits += [f"at least {at_least:g}"] if at_least > -np.inf else []
    limits += [f"below {below:.10g}"] if below < np.inf else []
    raise ProblemError(f"{name} must be {' and '.join(limits)} [{unit}]; got {number:g}.")


def load_reference(name: str, t_end: float) -> dict[str, Any] | None:
    """Read the rows of ``references/<name>.json`` up to ``t_end`` [s]; None if there are none.

    Returns
    -------
    dict
        ``t`` (k,), ``q, v`` (k, n), ``lam`` (k, m), ``mu`` (k, p), ``bars``: {quantity: (k,) scaled error bars}, ``digits``
        that the largest bar of q and v leaves, and ``source``.
    """
    file = REFERENCES / f"{name}.json"
    if not file.is_file():
        return None
    stored = json.loads(file.read_text(encoding="utf-8"))
    t = np.array(stored["t"], dtype=np.float64)
    rows = t <= t_end
    if not rows.any():
        return None
    values = {key: np.array(part, dtype=np.float64)[rows] for key, part in stored["values"].items()}
    values |= {key: np.zeros((int(rows.sum()), 0)) for key in ("lam", "mu") if key not in values}
    bars = {key: np.array(part, dtype=np.float64)[rows] for key, part in stored["bars"].items()}
    worst = max(bars[key].max() for key in ("q", "v"))
    if not np.isfinite(worst):
        return None  # nobody has confirmed it
    others = stored["confirmed_by"]
    confirmed = [other["solver"] for other in others if other["independent"] and other["status"] == "success"]
    source = f"{stored['first']}, confirmed by {' and '.join(confirmed)}"
    return {"t": t[rows], **values, "bars": bars, "digits": int(-np.log10(worst)), "source": source}


def minimal(name: str, *parameters: Any) -> Callable[[], MinimalCoordinates]:
    """Return a function that calls ``name`` of :mod:`problems._minimal` with ``parameters``; it imports the module."""
    return functools.partial(_minimal, name, parameters)


def _minimal(name: str, parameters: tuple[Any, ...]) -> MinimalCoordinates:
    from problems import _minimal as minimal_coordinates

    found: MinimalCoordinates = getattr(minimal_coordinates, name)(*parameters)
    return found
