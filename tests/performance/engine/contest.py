"""Section 4: one problem, every solver, a ladder of tolerances; run in a process of its own.

``python -m tests.performance.engine.contest SPEC SECONDS`` prints the runs, what the tables read of a
:class:`~hhtbench.store.rows.RunRow`, and the comparisons as one line of JSON.  Times are processor times of solves without
output before the end.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import asdict, dataclass
from typing import Any

from hhtbench import load_problem, load_solver
from hhtbench.analysis.cells import Point, state_error
from hhtbench.analysis.missing import NOT_RUN
from hhtbench.campaign.run import attempt, request_of, run_cell, succeeded, without_output
from hhtbench.evidence import plain
from hhtbench.protocol import Problem
from hhtbench.specs import canonical
from hhtbench.store import RunRow
from tests.performance.engine.callbacks import share_of
from tests.performance.engine.clock import once
from tests.performance.engine.duels import duels
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
    "projected(method=Tsit5)",
    "cvode(form=ode, method=bdf)",
    "scipy(method=LSODA)",
    "scipy(method=Radau)",
    "ida(form=integrated)",
    "ida(form=index2)",
    "ida(form=index3)",
)
MAX_SECONDS = 3.0  # of one solve: more than a hundred times what HHT needs on most problems [s]
REPEATS = 2  # of every run, to find who is compared with whom; the comparisons repeat what they need
STARTS = 3  # times of a start
BEHIND = 100.0  # times what HHT's longest solve takes: behind it, and LONG, a finer tolerance of another decides nothing
LONG = 0.5  # solves from which one time is enough [s]
DECIDING = 8.0  # for the comparisons of one problem [s]
CLIMBING = 0.7  # of the time of the problem, after which no solve of a ladder is begun
WORST = 1.0  # errors above it are of no interest: not timed again
DIGITS = 5  # of a number in the file
MESSAGE = 160  # characters of why a run failed
MINIMAL = "minimal, "
HOPELESS = ("declined", "deadline", "user_exception", NOT_RUN)  # a finer tolerance ends alike


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


def contest(spec: str, seconds: float) -> tuple[list[RunRow], list[dict[str, Any]]]:
    """All rows of the problem ``spec``, and the comparisons; cells that ``seconds`` [s] do not suffice for say so."""
    climbing, limit = (Limit(time.perf_counter() + part * seconds) for part in (CLIMBING, 1.0))
    problem = load_problem(spec)
    entrants = [Entrant(name, *_entrant(name, problem, spec)) for name in ENTRANTS]
    slowest = LONG
    for entrant in entrants:
        if entrant.solver is not None:
            _climb(entrant, problem, spec, climbing, slowest)
            if entrant.spec.startswith("hht"):
                slowest = max([slowest, *(BEHIND * row.timing.get("solve_s", 0.0) for row in entrant.rows)])
    timer = Timer(entrants, problem)
    timer.all_in_turn(limit)
    rows = [row for entrant in entrants for row in entrant.rows]
    compared = duels(rows, timer.solve, min(DECIDING, limit.end - time.perf_counter()))
    timer.note()
    for entrant in entrants:
        _watch_callbacks(entrant, problem, limit)
    return rows, compared


def _entrant(name: str, problem: Problem, spec: str) -> tuple[Any, list[RunRow]]:
    """The solver, or None and the row that says why."""
    if not name.startswith(MINIMAL):
        return load_solver(name), []
    reduced = reduced_of(problem)
    if reduced is None:
        reason = "no minimal coordinates are written down for this problem"
        return None, [_row(spec, name, 1e-2, {"status": "declined", "message": reason})]
    return MinimalSolver(load_solver(name.removeprefix(MINIMAL)), reduced), []


def _climb(entrant: Entrant, problem: Problem, spec: str, limit: Limit, slowest: float) -> None:
    """From the loosest tolerance to the one that reaches ``FINEST``, or the first that takes too long, ``slowest`` [s]."""
    warm: dict[str, float] = {}
    took, ours = 0.0, entrant.spec.startswith("hht")
    for rtol in LADDERS.get(entrant.spec.partition("(")[0], LADDERS[""]):
        if limit.passed():
            found: dict[str, Any] = {"status": NOT_RUN, "message": "the time of the section was up"}
        elif took > slowest and not ours:
            text = f"the tolerance before took {took:.1f} s, over {BEHIND:.0f} times HHT's longest"
            found = {"status": NOT_RUN, "message": text}
        else:
            found = run_cell(problem, entrant.solver, _asked(rtol), warm, lambda _: None)
        row = _row(spec, entrant.spec, rtol, found)
        entrant.rows.append(row)
        took = row.timing.get("solve_s", 0.0)
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


class Timer:
    """Processor times of the runs that succeeded."""

    def __init__(self, entrants: list[Entrant], problem: Problem) -> None:
        self.problem = problem
        self.runs = {row.key: (entrant.solver, row) for entrant in entrants for row in entrant.rows if _of_interest(row)}
        self.taken: dict[str, list[float]] = {key: [] for key in self.runs}

    def all_in_turn(self, limit: Limit) -> None:
        """Every run some times, a long one once."""
        for repeat in range(REPEATS):
            for key, (_, row) in self.runs.items():
                if not (limit.passed() or (repeat and row.timing["solve_s"] > LONG)):
                    self._solve(key)
        self.note()

    def solve(self, run: Point) -> float | None:
        """One more of ``run``; None where it failed."""
        return self._solve(run.key)

    def _solve(self, key: str) -> float | None:
        solver, row = self.runs[key]
        outcome = attempt(self.problem, solver, without_output(self.problem, request_of(self.problem, row.request)))
        if not succeeded(outcome):
            return None
        self.taken[key].append(outcome.cpu)
        return outcome.cpu

    def note(self) -> None:
        """The best of each in its row."""
        for key, (_, row) in self.runs.items():
            if self.taken[key]:
                row.timing.update(best_s=min(self.taken[key]), repeats=len(self.taken[key]))


def _of_interest(row: RunRow) -> bool:
    error = state_error(row) if row.success else None
    return error is not None and error <= WORST


def _watch_callbacks(entrant: Entrant, problem: Problem, limit: Limit) -> None:
    """Of the most accurate run that succeeded: its start alone, and in an untimed solve the share of the callbacks."""
    good = [row for row in entrant.rows if _of_interest(row)]
    if not good or limit.passed() or good[-1].timing["solve_s"] > LONG:
        return
    request = without_output(problem, request_of(problem, good[-1].request))
    starts = [once(lambda: entrant.solver.warm_up(problem, request)).cpu for _ in range(STARTS)]
    good[-1].timing["start_s"] = min(starts)
    share = share_of(problem, entrant.solver, request)
    if share is not None:
        good[-1].timing["callbacks"] = asdict(share)


def kept(row: RunRow) -> dict[str, Any]:
    """What the tables read of a row."""
    errors, drift = row.metrics.get("errors") or {}, row.metrics.get("drift") or {}
    sizes = {name: {"max_scaled": entry["max_scaled"]} for name, entry in errors.items() if name in ("q", "v")}
    if not sizes and errors:
        sizes = {"observables": errors.get("observables") or {}}
    measured = {"errors": {**sizes, "digits": errors.get("digits")}} if errors else {}
    measured["drift"] = {name: drift[name] for name in ("position", "velocity") if drift.get(name) is not None}
    times = {name: row.timing[name] for name in ("solve_s", "best_s", "start_s", "callbacks") if name in row.timing}
    return {
        "problem": row.problem,
        "solver": row.solver,
        "request": {"rtol": row.request["rtol"]},
        "status": row.status,
        "message": "" if row.success else row.message[:MESSAGE],
        "metrics": rounded(measured),
        "timing": rounded(times),
    }


def rounded(value: Any) -> Any:
    """All numbers to the digits that count."""
    if isinstance(value, dict):
        return {name: rounded(entry) for name, entry in value.items()}
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def main(spec: str, seconds: str) -> None:
    """Runs and comparisons as one line of JSON."""
    rows, compared = contest(spec, float(seconds))
    found = {"runs": [kept(row) for row in rows], "duels": rounded(plain(compared))}
    sys.stdout.write(json.dumps(plain(found)) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
