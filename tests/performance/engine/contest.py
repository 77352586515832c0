"""Section 4: one problem, every solver, a ladder of tolerances; run in a process of its own.

``python -m tests.performance.engine.contest SPEC SECONDS`` prints the rows, as :class:`~hhtbench.store.rows.RunRow`
holds them, as one line of JSON.  Times are processor times of solves without output before the end.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from dataclasses import asdict, dataclass
from typing import Any

from hhtbench import load_problem, load_solver
from hhtbench.analysis.cells import state_error
from hhtbench.campaign.metrics import plain
from hhtbench.campaign.run import attempt, request_of, run_cell, succeeded, without_output
from hhtbench.protocol import Problem
from hhtbench.specs import canonical
from hhtbench.store import RunRow
from tests.performance.engine.callbacks import share_of
from tests.performance.engine.clock import in_turn
from tests.performance.engine.minimal import MinimalSolver, reduced_of
from tests.performance.engine.ours import SPEC

FINEST = 1e-4  # the smallest error in the tables: a ladder ends when it is reached
LADDERS = {
    "hht": (3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7),
    "": (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8),
}
ENTRANTS = (
    SPEC.format(alpha=-0.05),
    SPEC.format(alpha=-0.3),
    "scipy(method=DOP853)",
    "projected(method=DOP853)",
    "ida(form=ggl)",
    "ida(form=index1)",
    "cvode(form=ode, method=adams)",
    "minimal, scipy(method=DOP853)",
    "minimal, cvode(form=ode, method=bdf)",
    "projected(method=RK45)",
    "cvode(form=ode, method=bdf)",
    "scipy(method=LSODA)",
    "scipy(method=Radau)",
    "ida(form=integrated)",
    "ida(form=index2)",
    "ida(form=index3)",
)
MAX_SECONDS = 5.0  # of one solve [s]
REPEATS = 5
LONG = 0.5  # solves from which one time is enough [s]
WORST = 1.0  # errors above it are of no interest: not timed again
MINIMAL = "minimal, "
HOPELESS = ("declined", "deadline", "user_exception", "not run")  # a finer tolerance ends alike
NOT_RUN = "not run"  # status of a cell for which the section's time did not suffice


@dataclass
class Entrant:
    """One solver on the problem."""

    spec: str
    solver: Any
    rows: list[RunRow]


@dataclass
class Limit:
    """When the time of the problem is up."""

    end: float

    def passed(self) -> bool:
        return time.perf_counter() > self.end


def contest(spec: str, seconds: float) -> list[RunRow]:
    """All rows of the problem ``spec``; cells that ``seconds`` [s] without compilation do not suffice for say so."""
    limit = Limit(time.perf_counter() + seconds)
    problem = load_problem(spec)
    entrants = [Entrant(name, *_entrant(name, problem, spec)) for name in ENTRANTS]
    for entrant in entrants:
        if entrant.solver is not None:
            _climb(entrant, problem, spec, limit)
    _time_in_turn(entrants, problem, limit)
    for entrant in entrants:
        _watch_callbacks(entrant, problem, limit)
    return [row for entrant in entrants for row in entrant.rows]


def _entrant(name: str, problem: Problem, spec: str) -> tuple[Any, list[RunRow]]:
    """The solver, or None and the row that says why."""
    if not name.startswith(MINIMAL):
        return load_solver(name), []
    reduced = reduced_of(problem)
    if reduced is None:
        reason = "no minimal coordinates are written down for this problem"
        return None, [_row(spec, name, 1e-2, {"status": "declined", "message": reason})]
    return MinimalSolver(load_solver(name.removeprefix(MINIMAL)), reduced), []


def _climb(entrant: Entrant, problem: Problem, spec: str, limit: Limit) -> None:
    """From the loosest tolerance to the one that reaches ``FINEST``, or the first that takes too long."""
    warm: dict[str, float] = {}
    for rtol in LADDERS.get(entrant.spec.partition("(")[0], LADDERS[""]):
        if limit.passed():
            found: dict[str, Any] = {"status": NOT_RUN, "message": "the time of the section was up"}
        else:
            cold = "s" not in warm
            found = run_cell(problem, entrant.solver, _asked(rtol), warm, lambda _: None)
            limit.end += warm.get("s", 0.0) if cold else 0.0
        row = _row(spec, entrant.spec, rtol, found)
        entrant.rows.append(row)
        error = state_error(row) if row.success else None
        if row.status in HOPELESS or (error is not None and error <= FINEST):
            return


def _asked(rtol: float) -> dict[str, Any]:
    """The request of a cell: the times of the reference and the ends."""
    none = dict.fromkeys(("atol", "step", "steps"))
    return {"rtol": rtol, **none, "outputs": 2, "counting": False, "max_seconds": MAX_SECONDS}


def _row(problem: str, solver: str, rtol: float, found: dict[str, Any]) -> RunRow:
    name = solver if solver.startswith(MINIMAL) else canonical(solver)
    kept = {key: found.get(key) or {} for key in ("metrics", "counters", "timing")}
    return RunRow(
        key=f"{problem} {name} {rtol:g}",
        problem=canonical(problem),
        solver=name.replace("'", ""),
        request=_asked(rtol),
        status=found["status"],
        message=found["message"],
        **kept,
    )


def _time_in_turn(entrants: list[Entrant], problem: Problem, limit: Limit) -> None:
    """Rounds over all runs that succeeded: the processor time of each, best and median."""
    runs = [(entrant.solver, row) for entrant in entrants for row in entrant.rows if _of_interest(row)]
    taken: dict[str, list[tuple[float, float]]] = {row.key: [] for _, row in runs}
    for repeat in range(REPEATS):
        for solver, row in runs:
            late = limit.passed() or row.timing["solve_s"] > LONG
            if repeat and late:
                continue
            outcome = attempt(problem, solver, without_output(problem, request_of(problem, row.request)))
            if succeeded(outcome):
                taken[row.key].append((outcome.cpu, outcome.seconds))
    for _, row in runs:
        cpu, wall = [[pair[i] for pair in taken[row.key]] for i in range(2)]
        if cpu:
            own = {"best_s": min(cpu), "median_s": statistics.median(cpu), "repeats": len(cpu)}
            row.timing.update(own, wall_s=statistics.median(wall))


def _of_interest(row: RunRow) -> bool:
    error = state_error(row) if row.success else None
    return error is not None and error <= WORST


def _watch_callbacks(entrant: Entrant, problem: Problem, limit: Limit) -> None:
    """Of the most accurate run that succeeded: its start alone, and in an untimed solve the share of the callbacks."""
    good = [row for row in entrant.rows if _of_interest(row)]
    if not good or limit.passed() or good[-1].timing["solve_s"] > LONG:
        return
    request = without_output(problem, request_of(problem, good[-1].request))
    start = in_turn({"": lambda: entrant.solver.warm_up(problem, request)}, REPEATS)[""]
    good[-1].timing["start_s"] = start.cpu
    share = share_of(problem, entrant.solver, request)
    if share is not None:
        good[-1].timing["callbacks"] = asdict(share)


def main(spec: str, seconds: str) -> None:
    """The rows as one line of JSON."""
    rows = contest(spec, float(seconds))
    sys.stdout.write(json.dumps([plain(asdict(row)) for row in rows]) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
