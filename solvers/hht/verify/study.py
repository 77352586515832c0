"""Framework of the verifications: studies are functions that return rows and plots, run and collected here."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import as_completed
from typing import Any

import numpy as np

from hhtbench.protocol.evidence import Evidence, Plot, Row
from hhtbench.runtime.processes import worker_processes

Progress = Callable[[str, int, int], None]  #: (what is counted, number done, total)
Study = tuple[Any, ...]  # (function that returns rows and plots, *arguments), to be sent to worker processes
Method = dict[str, Any]  # options of HHT

ALPHAS = (0.0, -0.05, -0.15, -0.3, -1.0 / 3.0)
NAMES = {0.0: "0", -0.05: "-0.05", -0.15: "-0.15", -0.3: "-0.3", -1.0 / 3.0: "-1/3"}


def named(method: Method) -> str:
    """The options of ``method`` as text for a claim."""
    return ", ".join(f"{key} = {NAMES.get(value, value) if key == 'alpha' else value}" for key, value in method.items())


def verify(title: str, studies: Iterable[Study], progress: Progress | None, jobs: int) -> Evidence:
    """Run all ``studies`` and collect their results as Evidence; other arguments as in :func:`run_all`."""
    began = time.perf_counter()
    return collected(title, run_all(studies, progress, jobs), began)


def run_all(studies: Iterable[Study], progress: Progress | None, jobs: int) -> list[Any]:
    """Results of ``studies`` in their order, computed by ``jobs`` processes.

    ``progress`` is called with the number of finished studies and their total.
    """
    studies, tell = list(studies), progress or (lambda *_: None)
    tell("studies", 0, len(studies))
    if jobs == 1:
        results = []
        for study in studies:
            results.append(study[0](*study[1:]))
            tell("studies", len(results), len(studies))
        return results
    with worker_processes(jobs) as pool:
        futures = [pool.submit(*study) for study in studies]
        for count, _ in enumerate(as_completed(futures), 1):
            tell("studies", count, len(studies))
        return [future.result() for future in futures]


def collected(title: str, found: Iterable[Any], began: float) -> Evidence:
    """Evidence from rows and plots, single or in lists; ``began``: value of ``time.perf_counter`` at the start."""
    items = [item for part in found for item in (part if isinstance(part, list) else [part])]
    rows, plots = tuple(x for x in items if isinstance(x, Row)), tuple(x for x in items if isinstance(x, Plot))
    return Evidence(title=title, rows=rows, plots=plots, seconds=time.perf_counter() - began)


def judged_row(id: str, claim: str, measured: str | float, bound: str, passed: bool) -> Row:
    """Row for a claim that passed or failed."""
    return Row(id=id, claim=claim, measured=measured, bound=bound, passed=passed)


def below_row(id: str, claim: str, measured: float, bound: float) -> Row:
    """Row for a number that must stay below ``bound``."""
    return judged_row(id, claim, measured, f"< {bound:g}", measured < bound)


def order_row(id: str, claim: str, orders: Mapping[str, float], wanted: float, margin: float) -> Row:
    """Row for orders that must all lie within ``margin`` of ``wanted``."""
    passed = all(abs(value - wanted) <= margin for value in orders.values())
    return judged_row(id, claim, _listed(orders), f"{wanted:.2f} +- {margin:g}", passed)


def shown_row(id: str, claim: str, measured: str | Mapping[str, float]) -> Row:
    """Row that is shown but not judged: a text, or slopes by name."""
    text = measured if isinstance(measured, str) else _listed(measured)
    return Row(id=id, claim=claim, measured=text, bound="not judged", passed=None)


def _listed(slopes: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.3f}" for name, value in slopes.items())


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Least-squares slope of log(y) over log(x)."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])
