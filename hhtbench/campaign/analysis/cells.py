"""Reduce a row of the store to the few numbers that every table starts from."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hhtbench.campaign.store.rows import RunRow
from hhtbench.catalogue.specs import canonical
from hhtbench.protocol.errors import ProblemError

SUBJECT = "hht"  # the family that the comparison is about
TYPICAL_ERROR = 1e-4  # runs are compared at the error nearest to this: engineering accuracy
NEAR = 10.0  # errors within this factor of one another are called equal
MINIMAL = re.compile(
    r"minimal\(.*?\bsolver=['\"]?(\w+)"
)  # spec of a reformulated problem; the group: the solver that it calls
KEPT = "_point"  # attribute of a row that caches its Point; no field, so neither compared nor written
CONSTANT = ", steps=N"  # after a solver's spec: the curve of its runs with prescribed steps
DOUBTED = "unreliable"  # status of a run that came to an end whose result failed its check


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Tolerance or step of a request; a smaller ``value`` demands more accuracy."""

    kind: str  #: "rtol", "step" or "steps"
    value: float  #: relative tolerance, step [s] or 1 / number of steps
    text: str  #: as a reader would say it


@dataclass(frozen=True, kw_only=True)
class Rules:
    """Limits and target errors that a campaign gives every solver alike; stored in the request of every row."""

    accuracies: tuple[float, ...]  #: achieved scaled errors to reach
    max_seconds: float  #: of one solve [s]
    pair_seconds: float  #: of all solves of one problem by one solver [s]
    refinements: int  #: most solves of one problem by one solver


@dataclass(frozen=True, kw_only=True)
class Point:
    """One row of the store reduced to numbers; failed rows give one too."""

    key: str
    problem: str
    solver: str  #: its canonical spec
    entry: str  #: the spec without quotes, with ``CONSTANT`` where the request prescribes steps
    setting: Setting
    status: str
    message: str
    success: bool
    error: float | None  #: :func:`state_error`; None where the run failed or nothing was compared
    doubted: float | None  #: error of a run whose result was rejected; shown, never ranked
    lam: float | None  #: scaled error of the multipliers of position constraints, also of a run whose result was rejected
    mu: float | None  #: scaled error of the multipliers of velocity constraints
    compared: int | None  #: number of times at which the error was taken
    limit: float  #: error below which the reference cannot judge; 0 for an exact solution
    time: float | None  #: processor time of one solve [s]
    first: float | None  #: time of a solve before all others, compilation included [s]
    repeats: tuple[float, ...]  #: processor time of every repeat, spread over time [s]
    spent: float | None  #: time of the solve beside other work, or all it was allowed where it did not end [s]
    rules: Rules | None  #: rules of the campaign; None: the setting was asked for by itself
    held_out: bool  #: True: the problem played no part in the choice of defaults
    alone: bool  #: the time was taken alone on a core, not beside other work
    disturbed: bool  #: something else ran on the machine while the time was taken
    share: float | None  #: CPU time over wall time of the median solve
    call: float | None  #: operations of what the solver evaluates over those of a residual of the problem's equations
    evaluations: float | None  #: counted, each as ``call`` of them; as one where that is not known
    counts: Mapping[str, float]  #: those of the row's counters that were reported
    provenance: str  #: where the counts come from
    reached: float | None  #: fraction of the interval
    position: float | None  #: largest drift at this level; None where the level does not exist or was not measured
    velocity: float | None
    acceleration: float | None
    energy: float | None
    absolute: float | None  #: largest |g_i| in its own unit
    note: str  #: why the acceleration level was not measured

    @property
    def drift(self) -> float | None:
        """The larger of position and velocity drift, as far as measured; None if neither is."""
        return max((value for value in (self.position, self.velocity) if value is not None), default=None)

    def work(self, measure: str) -> float | None:
        """Return the cost by ``measure``: "time" [s] or "evaluations"."""
        return self.time if measure == "time" else self.evaluations


def family(entry: str) -> str:
    """Return a solver's name without arguments; for minimal coordinates the name of the solver inside."""
    inner = MINIMAL.match(entry)
    return inner[1] if inner else entry.partition("(")[0].partition(",")[0]


def number(mapping: Mapping[str, Any], *path: str) -> float | None:
    """Return the number at ``path`` in nested mappings; None if it is absent, null or not finite."""
    value: Any = mapping
    for name in path:
        if not isinstance(value, Mapping):
            return None
        value = value.get(name)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return None
    return float(value)


def setting_of(row: RunRow) -> Setting:
    """Return the request's tolerance, step or number of steps as a :class:`Setting`."""
    request = row.request
    if request.get("rtol") is not None:
        value = float(request["rtol"])
        return Setting(kind="rtol", value=value, text=f"rtol {_short(value)}")
    if request.get("step") is not None:
        value = float(request["step"])
        return Setting(kind="step", value=value, text=f"step {_short(value)} s")
    steps = request.get("steps")
    count = len(steps) if isinstance(steps, Sequence) else int(steps or 1)
    return Setting(kind="steps", value=1.0 / count, text=f"{count} steps")


def _short(value: float) -> str:
    """Format a setting: ``1e-03`` or ``2.5e-04``."""
    whole = f"{value:.0e}"
    return whole if float(whole) == value else f"{value:.3g}"


def kind_of(run: Point) -> str:
    """Return what a campaign refines in such runs: "rtol" or "steps"."""
    return "rtol" if run.setting.kind == "rtol" else "steps"


def entry_of(row: RunRow) -> str:
    """Return the name of the curve that the row belongs to: the solver, with ``CONSTANT`` for prescribed steps."""
    name = row.solver.replace("'", "").replace('"', "")
    return name if setting_of(row).kind == "rtol" else name + CONSTANT


def asked_of(entry: str) -> tuple[str, str]:
    """Split an entry into the solver's spec without quotes and what is refined, "rtol" or "steps", as :func:`kind_of`."""
    spec = entry.removesuffix(CONSTANT)
    return spec, "rtol" if spec == entry else "steps"


def spec_of(run: Point) -> str:
    """Return the solver's spec as ``hb.solve`` takes it, without quotes where they are not needed."""
    plain, _ = asked_of(run.entry)
    try:
        return plain if canonical(plain) == run.solver else run.solver
    except ProblemError:
        return run.solver


def state_error(row: RunRow) -> float | None:
    """Return the largest scaled error of q and v over the compared times; of the observables if neither was compared."""
    found = [number(row.metrics, "errors", name, "max_scaled") for name in ("q", "v")]
    known = [value for value in found if value is not None]
    if not known:
        observables = (row.metrics.get("errors") or {}).get("observables") or {}
        entries = [number(observables, name, "max_scaled") for name in observables]
        known = [value for value in entries if value is not None]
    return max(known, default=None)


def point(row: RunRow) -> Point:
    """Reduce a row to a :class:`Point`; the result is cached in the row, since a report asks a hundred times."""
    kept: dict[str, Any] = vars(row)
    if KEPT not in kept:
        kept[KEPT] = _reduced(row)
    found: Point = kept[KEPT]
    return found


def _reduced(row: RunRow) -> Point:
    alone = number(row.timing, "best_s")
    digits = number(row.metrics, "errors", "digits")
    compared = number(row.metrics, "errors", "points")
    operations, residual = (number(row.metrics, "call", name) for name in ("operations", "of_residual"))
    call = operations / residual if operations and residual else None
    count = number(row.counters, "residual_evaluations")
    cpu, wall = number(row.timing, "median_s"), number(row.timing, "wall_s")
    ended = row.success or row.status == DOUBTED
    drift = {name: number(row.metrics, "drift", name) for name in ("position", "velocity", "acceleration", "energy")}
    return Point(
        key=row.key,
        problem=row.problem,
        solver=row.solver,
        entry=entry_of(row),
        setting=setting_of(row),
        status=row.status,
        message=row.message,
        success=row.success,
        error=state_error(row) if row.success else None,
        doubted=state_error(row) if row.status == DOUBTED else None,
        lam=number(row.metrics, "errors", "lam", "max_scaled") if ended else None,
        mu=number(row.metrics, "errors", "mu", "max_scaled") if ended else None,
        compared=None if compared is None else int(compared),
        limit=0.0 if digits is None else 10.0**-digits,
        time=_beside(row) if alone is None else alone,
        first=number(row.timing, "compile_s"),
        repeats=tuple(float(value) for value in row.timing.get("rounds_s") or [] if value),
        spent=_spent(row),
        rules=rules_of(row),
        held_out=row.request.get("held_out") is True,
        alone=alone is not None,
        disturbed=row.timing.get("disturbed") is True,
        share=None if cpu is None or not wall else cpu / wall,
        call=call,
        evaluations=None if count is None else count * (call or 1.0),
        counts={name: value for name in row.counters if (value := number(row.counters, name)) is not None},
        provenance=str(row.counters.get("provenance") or "not reported"),
        reached=number(row.metrics, "reached"),
        absolute=number(row.metrics, "drift", "position_absolute"),
        note=(row.metrics.get("drift") or {}).get("acceleration_note") or "",
        **drift,
    )


def rules_of(row: RunRow) -> Rules | None:
    """Return the campaign's rules from the row's request; None if it has none."""
    rules = row.request.get("rules")
    if not rules:
        return None
    return Rules(**{**rules, "accuracies": tuple(rules["accuracies"])})


def _beside(row: RunRow) -> float | None:
    """Return the time of the accuracy pass's solve, run beside other work: processor time if known, else wall time [s]."""
    seconds = number(row.timing, "solve_cpu_s")
    return number(row.timing, "solve_s") if seconds is None else seconds


def _spent(row: RunRow) -> float | None:
    """Return the time of the solve [s]; a solve that was killed counts with its limit."""
    seconds = _beside(row)
    return number(row.request, "max_seconds") if seconds is None and row.status == "deadline" else seconds


def points(rows: Iterable[RunRow]) -> tuple[Point, ...]:
    """Return one point per row, in their order."""
    return tuple(point(row) for row in rows)


def problems(rows: Iterable[RunRow]) -> tuple[str, ...]:
    """Return the problems in order of first appearance."""
    return tuple(dict.fromkeys(row.problem for row in rows))


def by_entry(found: Iterable[Point]) -> dict[str, list[Point]]:
    """Group points by solver entry, loosest setting first."""
    groups: dict[str, list[Point]] = {}
    for item in found:
        groups.setdefault(item.entry, []).append(item)
    return {name: sorted(group, key=lambda item: -item.setting.value) for name, group in groups.items()}


def by_problem(found: Iterable[Point]) -> dict[str, dict[str, list[Point]]]:
    """Group points by problem and solver entry, loosest setting first: the curves of error against work."""
    groups: dict[str, list[Point]] = {}
    for item in found:
        groups.setdefault(item.problem, []).append(item)
    return {name: by_entry(group) for name, group in groups.items()}


def entries(rows: Iterable[RunRow]) -> tuple[str, ...]:
    """Return every solver's entry in order of first appearance."""
    return tuple(dict.fromkeys(entry_of(row) for row in rows))


def typical(runs: Sequence[Point], error: float = TYPICAL_ERROR) -> Point:
    """Return the run with the error nearest to ``error``; else that with the middle setting, else a failed one."""
    good = [run for run in runs if run.success]
    measured = [run for run in good if run.error]
    if measured:
        return min(measured, key=lambda run: abs(math.log10((run.error or 1.0) / error)))
    chosen = good or list(runs)
    return chosen[len(chosen) // 2]
