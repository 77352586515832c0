"""A cell: a problem at one point of an axis, a request, what is known of the answer, and what became of a solver in it."""

from __future__ import annotations

import enum
import math
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hhtbench.api import solve
from hhtbench.errors import ProblemError
from hhtbench.protocol import Problem, Solver
from hhtbench.registry import load_solver
from hhtbench.result import Counters, Solution, Status
from hhtbench.specs import parse_spec

SECONDS = 3.0  # of one solve, unless a cell says otherwise
COMPILING = 60.0  # the same of the single step before it, in which functions are compiled
ROWS = 21  # of output under error control; prescribed steps are all seen, between them an interpolant would be judged too
OUT_OF_BUDGET = (Status.deadline, Status.max_steps, Status.evaluation_budget)
DIED = (Status.crashed, Status.out_of_memory)

Error = Callable[..., float]  # of the problem, the solution, and those of the further runs of the cell


class Kind(enum.Enum):
    """How a cell ended; ``letter`` stands for it where room is short."""

    right = ("right", "r", "arrived, the error as small as is expected")
    named = ("named", "n", "ended early and said so")
    budget = ("budget", "b", "out of its budget of time or steps")
    told = ("told", "t", "arrived with a larger error, whose cause its message names")
    wrong = ("wrong", "W", "arrived with a larger error and did not say so")
    crashed = ("crashed", "C", "raised an exception, ended its process or ran on beyond its budget")
    declined = ("declined", "-", "cannot be asked this; it says why")

    def __init__(self, label: str, letter: str, text: str) -> None:
        self.label = label
        self.letter = letter
        self.text = text

    @property
    def misleading(self) -> bool:
        """Whether it ended otherwise than a caller can rely on."""
        return self in (Kind.wrong, Kind.crashed)


@dataclass(frozen=True, kw_only=True)
class Expected:
    """One thing that is known of the answer."""

    error: Error
    most: float  #: largest error of an answer that counts as right


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One point of one axis."""

    x: float  #: the parameter
    line: str  #: what else differs within the axis, and how the steps are asked for
    make: Callable[[], Problem]
    request: Mapping[str, Any]  #: without `t_eval`: rows over the whole interval
    expected: Mapping[str, Expected]
    options: Mapping[str, Any] = field(default_factory=dict)  #: of the solver; one that has them not declines
    families: tuple[str, ...] = ()  #: solvers that it is about; none: all
    seconds: float = SECONDS
    further: tuple[tuple[Callable[[], Problem], Mapping[str, Any]], ...] = ()  #: runs that it is compared with
    cause: str = ""  #: words by which a message names what makes the error larger; none: no message does
    small: bool = False  #: one of the few that solvers from elsewhere are checked by

    def is_about(self, solver: Solver | str) -> bool:
        """Whether ``solver`` is one of the families."""
        return not self.families or (isinstance(solver, str) and parse_spec(solver).target in self.families)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of a solver in a cell."""

    kind: Kind
    status: str
    message: str
    errors: Mapping[str, float] = field(default_factory=dict)  #: of what is expected, where it arrived
    share: float | None = None  #: largest error over what is allowed
    steps: int | None = None
    evaluations: int | None = None
    attempts: int | None = None  #: of steps: those accepted and those rejected
    newton_iterations: int | None = None
    seconds: float = 0.0  #: on the clock, compilation included


@dataclass(frozen=True)
class Axis:
    """One parameter up to its extremes."""

    name: str
    label: str  #: of the parameter, with its unit
    make: Callable[[int], Iterable[Cell]]

    @property
    def sentence(self) -> str:
        """What goes in and where the expectation comes from: the first line of the docstring."""
        return (self.make.__doc__ or "").partition("\n")[0]

    def cells(self, seed: int = 0) -> Sequence[Cell]:
        """All cells, the same for the same ``seed``."""
        return tuple(self.make(seed))


def axis(name: str, label: str) -> Callable[[Callable[[int], Iterable[Cell]]], Axis]:
    """Make a function of the seed that gives cells the axis ``name``."""
    return lambda make: Axis(name, label, make)


def measure(cell: Cell, solver: Solver | str) -> Outcome:
    """One solve, judged; whatever a solver raises is how it ended."""
    try:
        chosen = _with(solver, cell.options)
    except ProblemError as error:
        return Outcome(kind=Kind.declined, status=Status.declined.label, message=str(error))
    began = time.perf_counter()
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            outcome = _solved(cell, chosen)
    except Exception as error:  # noqa: BLE001
        text = f"{type(error).__name__}: {error}"
        outcome = Outcome(kind=Kind.crashed, status=Status.crashed.label, message=text)
    return replace(outcome, seconds=time.perf_counter() - began)


def _solved(cell: Cell, solver: Solver) -> Outcome:
    """Functions are compiled in a solve of one step before those with the cell's budget; the first that fails counts."""
    problem = cell.make()
    request = _rows(problem, cell.request)
    solve(problem, solver, **{**request, "max_seconds": COMPILING, "max_num_steps": 1})
    runs = [solve(problem, solver, max_seconds=cell.seconds, **request)]
    for make, asked in cell.further:
        runs.append(solve(make(), solver, max_seconds=cell.seconds, **_rows(problem, asked)))
    failed = [run for run in runs if not run.success]
    return judge(cell, problem, failed[0]) if failed else judge(cell, problem, *runs)


def _rows(problem: Problem, request: Mapping[str, Any]) -> dict[str, Any]:
    rows = {"t_eval": np.linspace(*problem.t_span, ROWS)} if "rtol" in request else {}
    return {**rows, **request}


def _with(solver: Solver | str, options: Mapping[str, Any]) -> Solver:
    if options and not isinstance(solver, str):
        raise ProblemError("options can be given only to a solver that is named by a spec.")
    return load_solver(solver, **options)


def judge(cell: Cell, problem: Problem, found: Solution, *further: Solution) -> Outcome:
    """The class of an end; an error that is not a number is larger than any."""
    ended = Outcome(
        kind=_kind(found.status),
        status=found.status.label,
        message=found.message,
        steps=found.counters.steps_accepted,
        evaluations=found.counters.residual_evaluations,
        attempts=_attempts(found.counters),
        newton_iterations=found.counters.newton_iterations,
    )
    if not found.success:
        return ended
    errors = {name: float(known.error(problem, found, *further)) for name, known in cell.expected.items()}
    shares = [errors[name] / known.most for name, known in cell.expected.items()]
    share = max((x if math.isfinite(x) else math.inf for x in shares), default=math.inf)
    larger = Kind.told if cell.cause and cell.cause in found.message else Kind.wrong
    return replace(ended, kind=Kind.right if share <= 1.0 else larger, errors=errors, share=share)


def _attempts(c: Counters) -> int | None:
    """None where one of them is not counted."""
    if c.steps_accepted is None or c.steps_rejected_error is None or c.steps_rejected_newton is None:
        return None
    return c.steps_accepted + c.steps_rejected_error + c.steps_rejected_newton


def _kind(status: Status) -> Kind:
    if status is Status.declined:
        return Kind.declined
    if status in OUT_OF_BUDGET:
        return Kind.budget
    return Kind.crashed if status in DIED else Kind.named
