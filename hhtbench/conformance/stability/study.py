"""``hhtbench study stability``: measure every family of cells with every solver, and summarise each solver."""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from hhtbench.catalogue.specs import parse_spec
from hhtbench.conformance.entry import Entry, Kind, Outcome
from hhtbench.conformance.registry import FAMILIES, chosen
from hhtbench.conformance.stability.workers import Batch, cells_of, measure_all
from hhtbench.protocol.evidence import environment

SOLVERS = (
    "hht",
    "hht(alpha=-0.3)",
    "generalised_alpha",
    "hht_i3",
    "rattle",
    "ida",
    "cvode",
    "scipy(method=Radau)",
    "scipy(method=DOP853)",
    "projected",
    "collocation",
    "diffrax",
    "minimal",
)
SAFE = 0.75  # share of right cells on an axis, of which none misleads, from which on a solver is safe there
WORDS = {
    Kind.right: "right",
    Kind.named: "ended early and said so",
    Kind.budget: "out of budget",
    Kind.warned: "wrong, with a message that names the cause",
    Kind.wrong: "silently wrong",
    Kind.crashed: "crashed",
    Kind.hung: "hung",
}
FIELDS = ("solver", "x", "line", "status", "message", "share", "steps", "evaluations", "seconds")


@dataclass(frozen=True, kw_only=True)
class Stability:
    """Result of :func:`study_stability`."""

    axes: tuple[Entry, ...]
    solvers: tuple[str, ...]
    seed: int
    measured: tuple[Outcome, ...]  #: by axis, solver and place
    seconds: float  #: on the clock
    environment: Mapping[str, str] = field(default_factory=environment)

    def of(self, axis: str = "", solver: str = "", *kinds: Kind) -> list[Outcome]:
        """Return outcomes by axis, solver and kind; declined ones only if asked for."""
        return [x for x in self.measured if axis in ("", x.id) and solver in ("", x.solver) and x.kind in (kinds or WORDS)]

    def counts(self, axis: str = "", solver: str = "") -> Counter[Kind]:
        """Count outcomes by kind, on an axis and for a solver."""
        return Counter(x.kind for x in self.of(axis, solver))

    def sentence(self, solver: str) -> str:
        """Summarise where a solver is safe and where not."""
        counts = self.counts(solver=solver)
        if not counts:
            return f"{solver} can be asked none of these."
        slowest = max((x.seconds for x in self.of("", solver, Kind.named)), default=0.0)
        after = {Kind.named: f" within {slowest:.2g} s"}
        ends = ", ".join(f"{counts[kind]} {WORDS[kind]}{after.get(kind, '')}" for kind in WORDS if counts[kind])
        safe, seldom, unsafe = [], [], []
        for name in (axis.id for axis in self.axes if self.of(axis.id, solver)):
            own = self.counts(name, solver)
            wrong = [x.x for x in self.of(name, solver) if x.kind.misleading and x.x is not None]
            if wrong:
                between = f"{min(wrong):g} to {max(wrong):g}" if min(wrong) < max(wrong) else f"at {wrong[0]:g}"
                unsafe.append(f"{name} ({len(wrong)} of {own.total()}, {between})")
            elif own[Kind.right] >= SAFE * own.total():
                safe.append(name)
            else:
                seldom.append(f"{name} ({own[Kind.right]} right of {own.total()})")
        text = f"{solver}: of {counts.total()} cells {ends}."
        text += f" Safe on {', '.join(safe)}." if safe else " Safe on no whole axis."
        text += f" Never misleading, but seldom arriving, on {'; '.join(seldom)}." if seldom else ""
        return text + (f" Misleading on {'; '.join(unsafe)}." if unsafe else "")

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON: lines of an axis with one letter per cell, and the cells themselves."""
        return {
            "schema": "hhtbench.stability/2",
            "seed": self.seed,
            "seconds": self.seconds,
            "kinds": {kind.letter: f"{kind.label}: {kind.text}" for kind in (*WORDS, Kind.declined)},
            "sentences": {solver: self.sentence(solver) for solver in self.solvers},
            "axes": [
                {"name": x.id, "parameter": x.parameter, "what": x.sentence, "lines": letters(self.of(x.id, "", *Kind))}
                for x in self.axes
            ],
            "cells": [
                {"axis": x.id, "kind": x.kind.label, "errors": dict(x.errors)} | {name: getattr(x, name) for name in FIELDS}
                for x in self.measured
            ],
            "environment": dict(self.environment),
        }


def letters(measured: Sequence[Outcome]) -> dict[str, dict[str, str]]:
    """Return solver -> line -> one letter per cell along the parameter."""
    found: dict[str, dict[str, str]] = {}
    for x in sorted(measured, key=lambda x: x.x or 0.0):
        lines = found.setdefault(x.solver, {})
        lines[x.line] = lines.get(x.line, "") + x.kind.letter
    return found


def study_stability(
    only: Sequence[str] = (),
    solvers: Sequence[str] = (),
    *,
    seed: int = 0,
    jobs: int = 2,
    small: bool = False,
    tell: Callable[[Batch, Sequence[Outcome]], None] = lambda batch, measured: None,
    progress: Callable[[str, int, int], None] = lambda *_: None,
) -> Stability:
    """Measure the axes ``only`` (default: all) with ``solvers``; ``small``: few cells of each.

    ``tell`` is called after each batch and ``progress`` with the number of batches measured, from the thread that measured
    it.
    """
    began = time.perf_counter()
    axes, columns = chosen(FAMILIES, only, "axis"), tuple(solvers) or SOLVERS
    batches = [batch for axis in axes for solver in columns if (batch := _batch(axis, solver, seed, small)).places]
    done = itertools.count(1)

    def measured(batch: Batch, outcomes: Sequence[Outcome]) -> None:
        tell(batch, outcomes)
        progress("batches", next(done), len(batches))

    progress("batches", 0, len(batches))
    found = measure_all(batches, jobs, measured)
    seconds = time.perf_counter() - began
    return Stability(axes=axes, solvers=columns, seed=seed, measured=tuple(found), seconds=seconds)


def _batch(axis: Entry, solver: str, seed: int, small: bool) -> Batch:
    target = parse_spec(solver).target
    cells = cells_of(axis.id, seed)
    places = tuple(i for i, cell in enumerate(cells) if cell.is_about(target) and (cell.small or not small))
    return Batch(solver, axis.id, seed, places)
