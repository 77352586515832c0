"""Run one cell in a worker: decline, warm up, solve, check, measure.

Work is that of a solve to the end of the interval without intermediate output.  Errors, curves and drift come from another
solve with output that stores its steps; for a solver that does not report its steps, drift comes from a third one with
output at every step.  Neither is timed or counted.
"""

from __future__ import annotations

import gc
import signal
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hhtbench.campaign.accuracy import same_time
from hhtbench.campaign.metrics import counters_of, measure
from hhtbench.checks.result.judge import judge
from hhtbench.checks.result.repeated import ends_elsewhere, impossible_work
from hhtbench.checks.result.success import doubt_about, too_few
from hhtbench.lowering import derive, operations
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem, Solver
from hhtbench.solution.request import Request, check_output_times
from hhtbench.solution.result import Counters, Ends, Solution, Status, ends_of

WARM_UP = "the warm-up"  #: name of the phase that compiles
MEASURING = "the measurement"  #: name of the phase that evaluates every step

TIMED = (
    "best_s",
    "median_s",
    "rounds_s",
    "repeats",
    "solves",
    "wall_s",
    "load",
    "disturbed",
)  #: keys of ``timing`` that are null until the timing pass


Phase = Callable[[str], None]  #: receives the name of the phase that begins; the parent limits its time


@dataclass(frozen=True)
class Judged:
    """Changes that the checks of a result make to its row."""

    row: dict[str, Any] = field(default_factory=dict)  #: status and message that replace the solver's
    note: str = ""  #: what could not be checked
    metrics: dict[str, Any] | None = None  #: ``metrics["trust"]``


@dataclass(frozen=True)
class Outcome:
    """Status and solution of one solve, or the reason why there is none."""

    status: Status
    message: str
    solution: Solution | None
    seconds: float  #: wall time [s]
    cpu: float  #: processor time of this process [s]


def of_plugins() -> tuple[type[BaseException], ...]:
    """Return the exception types to catch from a plugin's or a user's code.

    KeyboardInterrupt is among them in workers, where SIGINT raises none.
    """
    alone = signal.getsignal(signal.SIGINT) is signal.SIG_DFL
    return (Exception, SystemExit, KeyboardInterrupt) if alone else (Exception, SystemExit)


def request_of(problem: Problem, asked: Mapping[str, Any]) -> Request:
    """Return the Request of a cell: output at equal distances and at the times of the reference."""
    t0, t1 = problem.t_span
    times = np.linspace(t0, t1, asked["outputs"])
    if problem.reference is not None:
        known = np.asarray(problem.reference["t"], dtype=np.float64)
        known = np.unique(known[(known >= min(t0, t1)) & (known <= max(t0, t1))])
        known = _apart(known, np.array([t0, t1]), same_time(problem))
        times = np.union1d(_apart(times, known, same_time(problem)), known)
    times = times[::-1] if t1 < t0 and times[0] < times[-1] else times
    check_output_times(times, t0, t1)
    values = {name: asked[name] for name in ("rtol", "atol", "step", "steps", "max_seconds")}
    return Request(t_eval=times, **values)


def _apart(times: Vector, others: Vector, least: float) -> Vector:
    """Return those of ``times`` (k,) that are further than ``least`` [s] from each of ``others``.

    Between two times one rounding error apart no solver can make a step.
    """
    gaps = np.abs(times[:, None] - others).min(axis=1, initial=np.inf)
    return times[gaps > least]


def without_output(problem: Problem, request: Request) -> Request:
    """Return the request with output at the end of the interval only."""
    return replace(request, t_eval=np.array([problem.t_span[1]]))


def run_cell(
    problem: Problem, solver: Solver, asked: Mapping[str, Any], warm: dict[str, float], phase: Phase, draw: int = 0
) -> dict[str, Any]:
    """Run a cell and return its row without the key; ``warm["s"]`` stores the time of the pair's first warm-up.

    ``phase`` is called with the name of each phase that begins; ``draw`` selects the rows that are checked closely.
    """
    phase(WARM_UP)
    request = request_of(problem, asked)
    reason = solver.accepts(problem, request)
    if reason is not None:
        if not isinstance(reason, str):
            said = f"accepts: None or a text was expected; the solver returned {reason!r}."
            return {"status": Status.unreliable.label, "message": said}
        return {"status": Status.declined.label, "message": reason}
    if "s" not in warm:
        warm["s"] = warm_up(problem, solver, request)
    phase("the solve")
    outcome = attempt(problem, solver, replace(request, keep_steps=True))
    row: dict[str, Any] = {"status": outcome.status.label, "message": outcome.message}
    phase(MEASURING)  # the problem's functions may be traced for the first time
    row["metrics"] = {"system": system_of(problem), "call": call_of(problem, solver)}
    if outcome.solution is None:
        return row
    work = _work(problem, solver, request, outcome, phase)
    counters = outcome.solution.counters if work.solution is None else work.solution.counters
    if asked["counting"] and succeeded(work):
        counters = _counted(problem, solver, request, counters, phase)
    solution, doubt = _with_ends(problem, solver, request, outcome, phase)
    phase(MEASURING)
    judgement = _judged(problem, request, replace(outcome, solution=solution), work, doubt, draw)
    measured = measure(problem, solution)
    return {
        **row,
        **judgement.row,
        "message": " ".join(filter(None, (judgement.row.get("message", row["message"]), judgement.note, measured.note))),
        "metrics": {**row["metrics"], **measured.metrics, "trust": judgement.metrics},
        "series": measured.series,
        "counters": counters_of(counters),
        "timing": {"compile_s": warm["s"], "solve_s": work.seconds, "solve_cpu_s": work.cpu, **dict.fromkeys(TIMED)},
    }


def system_of(problem: Problem) -> dict[str, Any]:
    """Return ``metrics["system"]`` of a row: sizes (null if the functions raise at the start) and tags."""
    sizes: dict[str, int | None] = {"n": problem.q0.size, "m": None, "p": None}
    with suppress(*of_plugins()):  # the solve has reported it
        found = derive(problem.system, problem.t_span[0], problem.q0, problem.v0).structure
        sizes |= {"m": found.m, "p": found.p}
    return {**sizes, "tags": list(problem.tags)}


def call_of(problem: Problem, solver: Solver) -> dict[str, Any] | None:
    """Return ``metrics["call"]`` of a row: kind and operation count of the solver's residual evaluations; None if unknown.

    It also holds the operations of a residual of the problem's own equations.  A solver that does not state what it
    evaluates is taken to need accelerations, which cost more.
    """
    what, solved = "acceleration", problem
    with suppress(*of_plugins()):
        what, solved = solver.evaluates(problem)  # type: ignore[attr-defined] # solvers may have it
    with suppress(*of_plugins()):  # the counts stay what they are
        own = operations(problem.system, problem.t_span[0], problem.q0, problem.v0)
        there = own if solved is problem else operations(solved.system, solved.t_span[0], solved.q0, solved.v0)
        if own is not None and there is not None:
            return {"evaluates": what, "operations": there.get(what, there["acceleration"]), "of_residual": own["residual"]}
    return None


def succeeded(outcome: Outcome) -> bool:
    """True if the end, or a terminal event, was reached and the result passed its checks."""
    return outcome.status in (Status.success, Status.event)


def attempt(problem: Problem, solver: Solver, request: Request) -> Outcome:
    """Run one solve; an exception becomes a status, with the partial solution if there is one."""
    gc.collect()
    gc.disable()
    solution: Any = None
    raised: BaseException | None = None
    started, cpu = time.perf_counter(), time.process_time()
    try:
        solution = solver.solve(problem, request)
    except of_plugins() as error:  # a plugin's or a user's: it costs this cell only
        raised = error
    finally:
        cost = time.perf_counter() - started, time.process_time() - cpu
        gc.enable()
    if raised is not None:
        partial = getattr(raised, "partial_solution", None)
        kept = partial if isinstance(partial, Solution) else None
        return Outcome(status_of(raised), text_of(raised), kept, *cost)
    doubt = doubt_about(problem, request, solution) or impossible_work(solution.counters, cost[0])
    if doubt:
        kept = solution if isinstance(solution, Solution) else None
        return Outcome(Status.unreliable, doubt, kept, *cost)
    return Outcome(solution.status, solution.message, solution, *cost)


def _work(problem: Problem, solver: Solver, request: Request, outcome: Outcome, phase: Phase) -> Outcome:
    """Repeat the solve without intermediate output; return ``outcome`` itself if it ran out of time."""
    if outcome.status is Status.deadline:
        return outcome
    phase("the solve without output")
    return attempt(problem, solver, without_output(problem, request))


def _counted(problem: Problem, solver: Solver, request: Request, counters: Counters, phase: Phase) -> Counters:
    """Return the counters of the solver's own untimed counting run if it has one, else ``counters``."""
    count = getattr(solver, "count", None)
    if not callable(count):
        return counters
    phase(WARM_UP)  # it compiles too
    with suppress(Exception):  # the solve stands, and so does what was counted in it
        found = count(problem, replace(without_output(problem, request), max_seconds=None))
        return found if isinstance(found, Counters) else counters
    return counters


def _with_ends(problem: Problem, solver: Solver, request: Request, outcome: Outcome, phase: Phase) -> tuple[Solution, str]:
    """Return the solution with the ends of its steps if its end was reached, and an objection to them, or "".

    The ends are its own, or those of one more solve with output at every step whose counters fit.
    """
    reached = (Status.success, Status.event, Status.unreliable)
    solution: Any = outcome.solution
    if outcome.status not in reached:
        return solution, ""
    ends, doubt, counters = None, "", solution.counters
    phase(MEASURING)
    with suppress(*of_plugins()):  # what a plugin calls dense output
        ends = ends_of(solution)
    if ends is None or too_few(ends, counters):  # the mesh of some dense output is not that of the steps
        phase("the solve with output at every step")
        again = attempt(problem, solver, replace(request, t_eval=None))
        if again.status in reached and again.solution is not None:
            found = again.solution
            counters, ends = found.counters, Ends(t=found.t, q=found.q, v=found.v, carried=found.carried)
            doubt = f"{again.message} (with output at every step)" if again.status is Status.unreliable else ""
    return solution.but(ends=ends, counters=counters), doubt


def _judged(problem: Problem, request: Request, outcome: Outcome, work: Outcome, doubt: str, draw: int) -> Judged:
    """Check a success by its own rows and steps and by the other solves of the same cell."""
    if not succeeded(outcome) or outcome.solution is None:
        return Judged()
    seen = outcome.status is Status.event or any(map(np.size, outcome.solution.t_events))
    if seen and not (np.size(problem.events) or np.size(problem.inputs)):
        return Judged({"status": Status.unreliable.label, "message": "end: an event is reported, and none was asked for."})
    if not succeeded(work):
        return Judged({"status": work.status.label, "message": f"{work.message} (without output on the way)"})
    if doubt:
        return Judged({"status": Status.unreliable.label, "message": doubt})
    found = judge(problem, request, outcome.solution, draw=draw)
    doubt = found.doubt
    if not doubt and work.solution is not None:
        doubt = ends_elsewhere(problem, request, outcome.solution, work.solution)
    row = {"status": Status.unreliable.label, "message": doubt} if doubt else {}
    note = f"Equations of motion not judged: {found.not_judged}." if found.not_judged else ""
    return Judged(row, note, found.metrics())


def status_of(error: BaseException) -> Status:
    """Return the status for an exception; XLA reports a failed allocation under a name of its own."""
    if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error):
        return Status.out_of_memory
    return Status.declined if isinstance(error, ProblemError) else Status.user_exception


def text_of(error: BaseException) -> str:
    """Format an exception as type, text and the line that raised."""
    frame, place = error.__traceback__, ""
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    if frame is not None:
        place = f" (raised in {frame.tb_frame.f_code.co_filename.rpartition('/')[2]}, line {frame.tb_lineno})"
    return f"{type(error).__name__}: {error}{place}"


def warm_up(problem: Problem, solver: Solver, request: Request) -> float:
    """Compile before the timed solve, by the solver's own ``warm_up`` or by one solve; returns the seconds it took."""
    started = time.perf_counter()
    own = getattr(solver, "warm_up", None)
    if callable(own):
        with suppress(Exception):  # the solve that follows says it
            own(problem, request)
    else:
        attempt(problem, solver, request)
    seconds = time.perf_counter() - started
    gc.collect()
    gc.freeze()  # JAX's objects: every later collection would walk through them, 0.15 s each time
    return seconds
