"""``hhtbench study stability``: every axis of the extremes with every solver, and one sentence a solver."""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from hhtbench.conformance.entry import Entry, Kind, Outcome
from hhtbench.conformance.registry import FAMILIES, chosen
from hhtbench.conformance.stability.closed_forms import SOLVER, ClosedForms, measure_closed_forms
from hhtbench.conformance.stability.workers import Batch, cells_of, measure_all
from hhtbench.evidence import environment
from hhtbench.specs import parse_spec

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


@dataclass(frozen=True, kw_only=True)
class Stability:
    """What :func:`study_stability` found."""

    axes: tuple[Entry, ...]
    solvers: tuple[str, ...]
    seed: int
    measured: tuple[Outcome, ...]  #: by axis, solver and place
    seconds: float  #: on the clock
    closed_forms: ClosedForms | None = None  #: of a study of all axes with HHT
    environment: Mapping[str, str] = field(default_factory=environment)

    def of(self, axis: str = "", solver: str = "") -> list[Outcome]:
        """Cells of an axis, of a solver, or of both."""
        return [x for x in self.measured if axis in ("", x.id) and solver in ("", x.solver)]

    def counts(self, axis: str = "", solver: str = "") -> Counter[Kind]:
        """How many of them ended in which way."""
        return Counter(x.kind for x in self.of(axis, solver))

    def sentence(self, solver: str) -> str:
        """Where a solver is safe and where not."""
        counts = self.counts(solver=solver)
        asked = sum(count for kind, count in counts.items() if kind is not Kind.declined)
        if not asked:
            return f"{solver} can be asked none of these."
        slowest = max((x.seconds for x in self.of("", solver) if x.kind is Kind.named), default=0.0)
        after = {Kind.named: f" within {slowest:.2g} s"}
        told = ", ".join(f"{counts[kind]} {WORDS[kind]}{after.get(kind, '')}" for kind in WORDS if counts[kind])
        names = [axis.id for axis in self.axes]
        reached = [name for name in names if set(self.counts(name, solver)) - {Kind.declined}]
        honest = [name for name in reached if not self._misled(name, solver)]
        safe = [name for name in honest if self._arrived(name, solver) >= SAFE]
        shy = [f"{name} ({self._short_of(name, solver)})" for name in honest if name not in safe]
        unsafe = [f"{name} ({self._where(name, solver)})" for name in reached if name not in honest]
        text = f"{solver}: of {asked} cells {told}."
        text += f" Safe on {', '.join(safe)}." if safe else " Safe on no whole axis."
        text += f" Never misleading, but seldom arriving, on {'; '.join(shy)}." if shy else ""
        return text + (f" Misleading on {'; '.join(unsafe)}." if unsafe else "")

    def _arrived(self, axis: str, solver: str) -> float:
        """Share of right cells: an end out of budget is as far from it as any other early one."""
        counts = self.counts(axis, solver)
        return counts[Kind.right] / (counts.total() - counts[Kind.declined])

    def _short_of(self, axis: str, solver: str) -> str:
        counts = self.counts(axis, solver)
        return f"{counts[Kind.right]} right of {counts.total() - counts[Kind.declined]}"

    def _misled(self, axis: str, solver: str) -> list[Outcome]:
        return [x for x in self.of(axis, solver) if x.kind.misleading]

    def _where(self, axis: str, solver: str) -> str:
        """How many cells, and between which values of the parameter."""
        wrong = self._misled(axis, solver)
        low, high = min(x.x for x in wrong), max(x.x for x in wrong)
        asked = len(self.of(axis, solver)) - self.counts(axis, solver)[Kind.declined]
        between = f"at {low:g}" if low == high else f"{low:g} to {high:g}"
        return f"{len(wrong)} of {asked}, {between}"

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON: lines of an axis as one letter a cell, and the cells themselves."""
        return {
            "schema": "hhtbench.stability/1",
            "seed": self.seed,
            "seconds": self.seconds,
            "kinds": {kind.letter: f"{kind.label}: {kind.text}" for kind in (*WORDS, Kind.declined)},
            "sentences": {solver: self.sentence(solver) for solver in self.solvers},
            "axes": [
                {"name": axis.id, "parameter": axis.parameter, "what": axis.sentence, "lines": letters(self.of(axis.id))}
                for axis in self.axes
            ],
            "cells": [_plain(x) for x in self.measured],
            "closed_forms": None if self.closed_forms is None else self.closed_forms.as_dict(),
            "environment": dict(self.environment),
        }


WORDS = {
    Kind.right: "right",
    Kind.named: "ended early and said so",
    Kind.budget: "out of budget",
    Kind.warned: "wrong, with a message that names the cause",
    Kind.wrong: "silently wrong",
    Kind.crashed: "crashed",
    Kind.hung: "hung",
}


def letters(measured: Sequence[Outcome]) -> dict[str, dict[str, str]]:
    """Solver -> line -> a letter a cell, along the parameter."""
    groups: dict[str, dict[str, list[Outcome]]] = {}
    for x in measured:
        groups.setdefault(x.solver, {}).setdefault(x.line, []).append(x)
    return {solver: {line: _spelled(own) for line, own in lines.items()} for solver, lines in groups.items()}


def _spelled(line: Sequence[Outcome]) -> str:
    return "".join(x.kind.letter for x in sorted(line, key=lambda x: x.x))


PLAIN = (
    "solver",
    "x",
    "line",
    "status",
    "message",
    "share",
    "steps",
    "evaluations",
    "attempts",
    "newton_iterations",
    "seconds",
)


def _plain(x: Outcome) -> dict[str, Any]:
    return {"axis": x.id, "kind": x.kind.label, "errors": dict(x.errors), **{name: getattr(x, name) for name in PLAIN}}


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
    """Measure the axes ``only``, by default all, with ``solvers``; ``small``: few cells of each.

    ``tell`` hears of each batch, ``progress`` how many of how many are measured, both from the thread that has measured it.
    """
    began = time.perf_counter()
    axes, columns = chosen(FAMILIES, only, "axis"), tuple(solvers) or SOLVERS
    batches = [batch for axis in axes for solver in columns if (batch := _batch(axis, solver, seed, small)).places]
    done = itertools.count(1)

    def told(batch: Batch, measured: Sequence[Outcome]) -> None:
        tell(batch, measured)
        progress("batches", next(done), len(batches))

    asked = not only and any(parse_spec(solver).target == SOLVER for solver in columns)
    forms = measure_closed_forms() if asked else None
    progress("batches", 0, len(batches))
    found = measure_all(batches, jobs, told)
    places = {axis.id: index for index, axis in enumerate(axes)}
    found.sort(key=lambda x: (places[x.id], columns.index(x.solver)))
    seconds = time.perf_counter() - began
    return Stability(axes=axes, solvers=columns, seed=seed, measured=tuple(found), closed_forms=forms, seconds=seconds)


def _batch(axis: Entry, solver: str, seed: int, small: bool) -> Batch:
    about = parse_spec(solver).target
    cells = cells_of(axis.id, seed)
    places = tuple(i for i, cell in enumerate(cells) if cell.is_about(about) and (cell.small or not small))
    return Batch(solver, axis.id, seed, places)
