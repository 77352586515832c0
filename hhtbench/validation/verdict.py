"""From rows to verdicts: who agrees with the reference, who converges towards it, who disagrees, who fails and how."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from hhtbench.evidence import Row
from hhtbench.specs import parse_spec
from hhtbench.store import RunRow
from hhtbench.validation.plan import stepped

AGREEMENT = 1e-6  # largest scaled error of q and v along the trajectory
AGREEMENT_OF_STEPS = 1e-4  # the same at constant steps of a second-order method
CONVERGING = 0.2  # of the error at the next looser request: a solver on its way to the reference
NEAR = 1e-3  # error beyond which nothing counts as on its way
MULTIPLIER = 1e-2  # of the errors of lam and mu, which follow from q and v with the stiffness as a factor
ENOUGH = 6  # pairs that must agree
BUDGETS = ("deadline", "max_steps", "evaluation_budget")  # statuses that say nothing about the solver's answer
LIMIT = 3.0  # of the reference's own error bar: a result this close cannot be told from it


class Kind(Enum):
    """How a pair of problem and solver ended."""

    agrees = "agrees"
    converges = "converges"  # its error falls with the tolerance, but stays above the bound
    unfinished = "unfinished"  # above the bound, and the tighter runs that would tell ran out of budget
    disagrees = "disagrees"
    unknown = "no value to compare with"
    failed = "failed"
    declined = "declined"


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """One solver on one problem."""

    problem: str
    solver: str
    kind: Kind
    error: float | None  #: largest scaled error of q and v
    evaluations: int | None
    status: str  #: of the judged run
    message: str


def judge(rows: Iterable[RunRow]) -> list[Verdict]:
    """A verdict for every pair that ``rows`` hold, in their order."""
    groups: dict[tuple[str, str], list[RunRow]] = {}
    for row in rows:
        groups.setdefault((row.problem, row.solver), []).append(row)
    return [_verdict(*pair, group) for pair, group in groups.items()]


def error_of(row: RunRow) -> float | None:
    """Largest scaled error of q and v over the compared times, or None; of lam and mu too where it is not small.

    Multipliers follow from q and v with the stiffness as a factor, so they count MULTIPLIER times less.
    """
    errors = row.metrics.get("errors", {})
    weights = {"q": 1.0, "v": 1.0, "lam": MULTIPLIER, "mu": MULTIPLIER}
    values = [errors[name]["max_scaled"] for name in weights if name in errors]
    if not values or None in values:
        return None
    return max(weights[name] * errors[name]["max_scaled"] for name in weights if name in errors)


def _verdict(problem: str, solver: str, rows: list[RunRow]) -> Verdict:
    solved = [row for row in rows if row.success]
    known = [(error, row) for row in solved if (error := error_of(row)) is not None]
    if not solved:
        row = rows[-1]
        kind = Kind.declined if row.status == "declined" else Kind.failed
        return _made(problem, solver, kind, None, row)
    if not known:
        return _made(problem, solver, Kind.unknown, None, solved[-1])
    known.sort(key=lambda pair: effort(pair[1]))
    error, best = known[-1]  # the tightest
    bound = AGREEMENT_OF_STEPS if stepped(solver) else AGREEMENT
    if error <= max(bound, LIMIT * _bar(best)):
        return _made(problem, solver, Kind.agrees, error, best)
    falling = len(known) > 1 and error <= CONVERGING * known[-2][0] and error <= NEAR
    if falling:
        return _made(problem, solver, Kind.converges, error, best)
    cut = [row for row in rows if row.status in BUDGETS and effort(row) > effort(best)]
    alone = cut and len(known) == 1 and error <= NEAR  # nothing tells whether it would fall
    return _made(problem, solver, Kind.unfinished if alone else Kind.disagrees, error, best)


def short(solver: str) -> str:
    """A column's head: ``ida ggl``."""
    spec = parse_spec(solver)
    words = [str(value) for name, value in spec.arguments.items() if not (name == "form" and value == "ode")]
    return " ".join([spec.name, *words])


def effort(row: RunRow) -> float:
    """Grows with the tightness of what was asked."""
    asked = row.request
    return float(asked["steps"]) if asked["steps"] is not None else -float(asked["rtol"] or 0.0)


def _bar(row: RunRow) -> float:
    digits = row.metrics.get("errors", {}).get("digits")
    return 0.0 if digits is None else 10.0**-digits


def _made(problem: str, solver: str, kind: Kind, error: float | None, row: RunRow) -> Verdict:
    evaluations = row.counters.get("residual_evaluations")
    return Verdict(
        problem=problem,
        solver=solver,
        kind=kind,
        error=error,
        evaluations=evaluations,
        status=row.status,
        message=row.message,
    )


def evidence_rows(verdicts: list[Verdict], reasons: dict[str, str], makers: frozenset[str] = frozenset()) -> list[Row]:
    """Per problem: nobody disagrees, and enough agree or there is a reason (``reasons``: problem -> why fewer).

    ``makers`` (canonical specs) made the references and do not count among those that agree.
    """
    rows = []
    for problem in dict.fromkeys(verdict.problem for verdict in verdicts):
        own = [verdict for verdict in verdicts if verdict.problem == problem]
        agree = [verdict.solver for verdict in own if verdict.kind is Kind.agrees]
        agree = [solver for solver in agree if not stepped(solver) and solver not in makers]
        wrong = [f"{v.solver} {v.error:.1e}" for v in own if v.kind is Kind.disagrees]
        claim = f"{problem}: no pair disagrees with the reference"
        rows.append(
            Row(id=f"{problem}/agree", claim=claim, measured="; ".join(wrong) or "none", bound="none", passed=not wrong)
        )
        few, reason = len(agree) < ENOUGH, reasons.get(problem, "")
        measured = f"{len(agree)}" + (f": {reason}" if few and reason else "")
        claim = f"{problem}: at least {ENOUGH} pairs agree to {AGREEMENT:g}, or a reason is known"
        rows.append(
            Row(id=f"{problem}/pairs", claim=claim, measured=measured, bound=str(ENOUGH), passed=not few or bool(reason))
        )
        steps = [verdict for verdict in own if verdict.solver == "hht"]
        good = any(verdict.kind is Kind.agrees for verdict in steps)
        shown = "; ".join(f"{v.error:.1e}" if v.error is not None else v.status for v in steps)
        claim = f"{problem}: HHT at constant steps agrees to {AGREEMENT_OF_STEPS:g}"
        rows.append(
            Row(
                id=f"{problem}/hht",
                claim=claim,
                measured=shown,
                bound=f"{AGREEMENT_OF_STEPS:g}",
                passed=good,
            )
        )
    return rows
