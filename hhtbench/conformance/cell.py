"""Families of cells: a problem at each value of a parameter, a request, the known answer, and how it is judged."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from hhtbench.api import solve
from hhtbench.conformance.entry import Entry, Kind, Known, Lane, Outcome
from hhtbench.conformance.subject import ACCURACY, Declined, Subject
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.solution.result import Solution, Status

MAX_SECONDS = 3.0  # of one solve, unless a cell says otherwise
MAX_COMPILING = 60.0  # [s] of the single step before it, in which functions are compiled
ROWS = 21  # output rows under error control; prescribed steps are all judged, but no interpolant between them
OUT_OF_BUDGET = (Status.deadline, Status.max_steps, Status.evaluation_budget)
DIED = (Status.crashed, Status.out_of_memory)

Error = Callable[..., float]  # function of the problem, the solution, and the solutions of the cell's further runs


@dataclass(frozen=True, kw_only=True)
class Expected:
    """A known quantity of the answer with its error function and bound."""

    error: Error
    most: float  #: largest error of an answer that counts as right


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One solve of a family: a problem at one value of the parameter, a request and the expected answer."""

    x: float  #: the parameter
    line: str  #: what else differs within the axis, and how the steps are asked for
    make: Callable[[], Problem]
    request: Mapping[str, Any]  #: without `t_eval`: rows over the whole interval
    expected: Mapping[str, Expected]
    options: Mapping[str, Any] = field(default_factory=dict)  #: options of the solver; one that does not have them declines
    families: tuple[str, ...] = ()  #: solvers that it is about; none: all
    seconds: float = MAX_SECONDS
    further: tuple[tuple[Callable[[], Problem], Mapping[str, Any]], ...] = ()  #: runs that it is compared with
    cause: str = ""  #: words by which a message names what makes the error larger; none: no message does
    small: bool = False  #: one of the few that solvers from elsewhere are checked by

    def __str__(self) -> str:
        """Within its family: "h = 0.01 s/1e+12"."""
        return f"{self.line}/{self.x:g}"

    def is_about(self, target: str) -> bool:
        """True if the cell applies to the solver ``target`` (a name without options)."""
        return not self.families or target in self.families


class Way(NamedTuple):
    """A request of a cell with its largest allowed error."""

    line: str
    request: Mapping[str, Any]
    most: float  #: largest error that a motion of ordinary size may have


def rtol(value: float, longer: float = 1.0) -> Way:
    """Request under error control; the allowed error is a hundred times the tolerance, times ``longer``."""
    return Way(f"rtol {value:g}", {"rtol": value}, ACCURACY * value * longer)


def step(h: float, most: float) -> Way:
    """Request with prescribed equal steps [s]."""
    return Way(f"h = {h:g} s", {"step": h}, most)


def cells(
    x: float,
    make: Callable[[], Problem],
    ways: Iterable[Way],
    expected: Mapping[str, Expected] | Callable[[float], Mapping[str, Expected]],
    *,
    named: str = "{}",
    t_eval: Any = ...,
    **given: Any,
) -> Iterator[Cell]:
    """Yield one cell per way, with the ``expected`` errors or ``expected(way.most)``; ``named`` formats their lines."""
    rows = {} if t_eval is ... else {"t_eval": t_eval}
    for line, request, most in ways:
        known = expected(most) if callable(expected) else expected
        yield Cell(x=x, line=named.format(line), make=make, request={**request, **rows}, expected=known, **given)


def family(id: str, parameter: str, known: Known | None = None) -> Callable[[Callable[[int], Iterable[Cell]]], Entry]:
    """Decorator that makes the family ``id`` of a function of the seed that yields cells, reproducible by seed.

    The first line of the function's docstring is the family's sentence: what goes in and where the expectation comes from.
    """

    def register(cells: Callable[[int], Iterable[Cell]]) -> Entry:
        sentence = (cells.__doc__ or "").partition("\n")[0]
        made = Entry(id=id, sentence=sentence, measure=measure, cells=cells, lane=Lane.extremes, parameter=parameter)
        return replace(made, known=known or {})

    return register


def measure(subject: Subject, cell: Cell) -> Outcome:
    """Solve one cell and judge the result.

    Functions are compiled in a solve of one step before those with the cell's budget; the first that fails counts.
    """
    if not cell.is_about(subject.target):
        raise Declined(f"it is about {' and '.join(cell.families)}.")
    try:
        solver = subject.fresh(**cell.options)
    except ProblemError as error:
        raise Declined(str(error)) from error
    problem = cell.make()
    request = _rows(problem, cell.request)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        solve(problem, solver, **{**request, "max_seconds": MAX_COMPILING, "max_num_steps": 1})
        runs = [solve(problem, solver, max_seconds=cell.seconds, **request)]
        for make, asked in cell.further:
            runs.append(solve(make(), solver, max_seconds=cell.seconds, **_rows(problem, asked)))
        failed = [run for run in runs if not run.success]
        found = judge(cell, problem, failed[0]) if failed else judge(cell, problem, *runs)
    return replace(found, x=cell.x, line=cell.line)


def _rows(problem: Problem, request: Mapping[str, Any]) -> dict[str, Any]:
    rows = {"t_eval": np.linspace(*problem.t_span, ROWS)} if "rtol" in request else {}
    return {**rows, **request}


def judge(cell: Cell, problem: Problem, found: Solution, *further: Solution) -> Outcome:
    """Classify the end of a solve; an error that is NaN counts as infinite."""
    ended = Outcome(
        kind=_kind(found.status),
        status=found.status.label,
        message=found.message,
        steps=found.counters.steps_accepted,
        evaluations=found.counters.residual_evaluations,
    )
    if not found.success:
        return ended
    errors = {name: float(known.error(problem, found, *further)) for name, known in cell.expected.items()}
    shares = [errors[name] / known.most for name, known in cell.expected.items()]
    share = max((x if math.isfinite(x) else math.inf for x in shares), default=math.inf)
    arrived = replace(ended, kind=Kind.right, errors=errors, share=share)
    if share <= 1.0:
        return arrived
    if cell.cause and cell.cause in found.message:
        return replace(arrived, kind=Kind.warned)
    found_off = ", ".join(f"{name} off by {error:.2g}" for name, error in errors.items())
    allowed = "; ".join(f"{known.most:.2g} of {name}" for name, known in cell.expected.items())
    return replace(arrived, kind=Kind.wrong, message=f"success, but {found_off}; allowed are {allowed}")


def _kind(status: Status) -> Kind:
    if status is Status.declined:
        return Kind.declined
    if status in OUT_OF_BUDGET:
        return Kind.budget
    return Kind.crashed if status in DIED else Kind.named
