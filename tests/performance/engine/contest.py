"""HHT beside the reference solvers at equal error, on every constrained problem of the library.

A campaign says what every solver pays for an error and how far it drifts.  HHT and its best rivals are then solved in turn:
what a side pays is interpolated between two of its runs, and a round solves all of them once.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from hhtbench import load_problem, load_solver
from hhtbench.campaign import Campaign, Grid, run_campaign
from hhtbench.campaign.analysis import fronts, points
from hhtbench.campaign.analysis.cells import SUBJECT, Point, by_entry, family
from hhtbench.campaign.analysis.fronts import STEADY, Cost, Front, constrained_levels, cost_at, holds, pareto
from hhtbench.campaign.execute import machine_limits
from hhtbench.campaign.reference.plan import registered_plans, validated_spec
from hhtbench.campaign.run import request_of, without_output
from hhtbench.campaign.store import RunRow, Store
from hhtbench.catalogue.registry import list_problems
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import declared
from tests.performance.engine.clock import BROKEN, HOLDS, UNDECIDED, compare

TARGETS = (1e-2, 1e-3, 1e-4)  # achieved scaled errors
QUICK = ("jay_negrut_pendulum", "andrews", "knife_edge")
ENTRANTS = (
    *("hht(alpha=-0.05)", "hht(alpha=-0.3)"),
    *("scipy(method=DOP853)", "scipy(method=LSODA)", "scipy(method=Radau)"),
    *("projected(method=DOP853)", "projected(method=Tsit5)"),
    *(f"ida(form={form})" for form in ("ggl", "index1", "integrated", "index2", "index3")),
    *("cvode(form=ode, method=adams)", "cvode(form=ode, method=bdf)"),
    *("minimal(solver=scipy, method=DOP853)", "minimal(solver=cvode, form=ode, method=bdf)"),
)
EXPLICIT = "scipy(method=DOP853)"  # high order, on the underlying ODE, never projected
RIVALS = ("holder", "other", "explicit")  # the fastest other that holds both levels, the fastest other, ``EXPLICIT``
RULES = {"max_seconds": 3.0, "pair_seconds": 6.0, "repeats": 1, "counting": False}
LOOKS = (8, 16, 32)  # rounds after which a comparison may be decided
PATIENCE = 3.0  # of one comparison [s]
FASTER, SLOWER = "faster", "slower"  # HHT is
VERDICTS = {HOLDS: FASTER, BROKEN: SLOWER, UNDECIDED: UNDECIDED}  # of HHT's time over the rival's, beside a limit of 1

Line = dict[str, Any]
Solve = Callable[[Point], Callable[[], object]]  # a run -> the action that makes it once more


def measure_contest(names: Sequence[str], store: Path) -> list[Line]:
    """One line a problem and error; all runs are kept in ``store``, made anew."""
    plan = registered_plans()
    specs = [spec for spec in (validated_spec(name, plan) for name in names or list_problems()) if _constrained(spec)]
    campaign = Campaign(grids=(Grid(problems=tuple(specs), solvers=ENTRANTS),), accuracies=TARGETS, **RULES)
    store.unlink(missing_ok=True)
    with Store(store) as opened:
        rows = run_campaign(campaign, opened, limits=machine_limits()).rows
    lines = []
    for problem in dict.fromkeys(row.problem for row in rows):
        own = [row for row in rows if row.problem == problem]
        lines += compared(own, partial(action_of, load_problem(problem), {row.key: row for row in own}))
    return lines


def _constrained(spec: str) -> bool:
    system = load_problem(spec).system
    return any(declared(system, name) is not None for name in ("constraint", "velocity_constraint"))


def action_of(problem: Problem, rows: Mapping[str, RunRow], run: Point) -> Callable[[], object]:
    """One more solve of ``run``, without output on the way."""
    request = without_output(problem, request_of(problem, rows[run.key].request))
    return partial(load_solver(run.solver).solve, problem, request)


def compared(rows: Sequence[RunRow], solve: Solve, patience: float = PATIENCE) -> list[Line]:
    """The lines of one problem: HHT, and every kind of rival with the comparison in turn."""
    lines, decided = [], dict[Any, Line]()
    found = points(rows)
    for free, held in zip(fronts(rows, "time", TARGETS), fronts(rows, "time", TARGETS, STEADY), strict=True):
        steady = _first(held, lambda cost: family(cost.entry) == SUBJECT)
        ours = steady or _first(free, lambda cost: family(cost.entry) == SUBJECT)
        rivals = {
            "holder": _first(held, lambda cost: family(cost.entry) != SUBJECT),
            "other": _first(free, lambda cost: family(cost.entry) != SUBJECT),
            "explicit": _first(free, lambda cost: cost.entry == EXPLICIT),
        }
        line: Line = {"problem": free.problem, "target": free.target, "subject": _side(ours), "why": _why(free, ours)}
        for kind, rival in rivals.items():
            line[kind] = _side(rival)
            if ours is not None and rival is not None:
                sides = _runs(found, ours, steady is not None), _runs(found, rival, kind == "holder")
                key = free.target, tuple(run.key for side in sides for run in side)
                if key not in decided:
                    decided[key] = _duel(sides, free.target, solve, patience)
                line[kind] |= decided[key]
        lines.append(line | {"steady": steady is not None})
    return lines


def _first(front: Front, wanted: Callable[[Cost], bool]) -> Cost | None:
    return next((cost for cost in front.costs if wanted(cost)), None)


def _side(cost: Cost | None) -> Line | None:
    """What a table shows of a cost, in seconds of the campaign."""
    if cost is None:
        return None
    return {"entry": cost.entry, "seconds": cost.value, "bound": cost.bound, "drift": cost.run.drift}


def _why(front: Front, ours: Cost | None) -> str:
    """Why HHT does not reach the error."""
    own = [reason for entry, reason in front.missing.items() if family(entry) == SUBJECT]
    return own[0].text if own and ours is None else ""


def _runs(found: Iterable[Point], cost: Cost, steady: bool) -> list[Point]:
    """The runs between which ``cost`` is interpolated, the accurate one last."""
    own = by_entry(found)[cost.entry]
    levels = constrained_levels(own)
    best = pareto([run for run in own if not steady or holds(run, levels, STEADY)], "time")
    place = next(i for i, run in enumerate(best) if run.key == cost.run.key)
    return list(best[max(place - 1, 0) : place + 1])


def _duel(sides: Sequence[Sequence[Point]], target: float, solve: Solve, patience: float) -> Line:
    """HHT's time over the rival's, by solves taken in turn."""

    def figure(seconds: Mapping[str, float]) -> float:
        costs = [cost_at([replace(run, time=seconds[run.key]) for run in side], target, "time") for side in sides]
        return costs[0].value / costs[1].value  # type: ignore[union-attr]

    actions = {run.key: solve(run) for side in sides for run in side}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of redundant constraints: the campaign has told
        line = compare(actions, figure, 1.0, patience, LOOKS).line()
    return {**line, "verdict": VERDICTS[line["verdict"]]}
