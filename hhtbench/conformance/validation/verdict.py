"""Verdicts from rows: a solver agrees with the reference, converges towards it, disagrees, or fails."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from hhtbench.campaign.store import RunRow
from hhtbench.catalogue.specs import parse_spec
from hhtbench.conformance.validation.plan import stepped
from hhtbench.protocol.evidence import Row

AGREEMENT = 1e-6  # largest scaled error of q and v along the trajectory
AGREEMENT_OF_STEPS = 1e-4  # the same at constant steps of a second-order method
CONVERGING = 0.2  # error over that at the next looser request: a solver that converges to the reference
NEAR = 1e-3  # error beyond which nothing counts as on its way
MULTIPLIER = 1e-2  # bound on errors of lam and mu, which follow from q and v with the stiffness as a factor
MIN_AGREEING = 6  # smallest number of pairs that must agree
BUDGETS = ("deadline", "max_steps", "evaluation_budget")  # statuses that say nothing about the solver's answer
LIMIT = 3.0  # multiple of the reference's error bar within which a result cannot be distinguished from it


class Kind(Enum):
    """Verdict on a pair of problem and solver."""

    agrees = "agrees"
    converges = "converges"  # its error falls with the tolerance, but stays above the bound
    unfinished = "unfinished"  # above the bound, and the tighter runs that would tell ran out of budget
    disagrees = "disagrees"
    unknown = "no value to compare with"
    failed = "failed"
    declined = "declined"


@dataclass(frozen=True)
class Verdict:
    """Verdict on one solver on one problem."""

    row: RunRow  #: the judged run
    kind: Kind
    error: float | None = None  #: largest scaled error of q and v

    @property
    def problem(self) -> str:
        """Canonical spec of the problem."""
        return self.row.problem

    @property
    def solver(self) -> str:
        """Canonical spec of the solver."""
        return self.row.solver


def judge(rows: Iterable[RunRow]) -> list[Verdict]:
    """Return a verdict for every pair of problem and solver in ``rows``, in their order."""
    groups: dict[tuple[str, str], list[RunRow]] = {}
    for row in rows:
        groups.setdefault((row.problem, row.solver), []).append(row)
    return [_verdict(group) for group in groups.values()]


def error_of(row: RunRow) -> float | None:
    """Return the largest scaled error of q, v and, with less weight, lam and mu over the compared times; None if not known.

    Multipliers follow from q and v with the stiffness as a factor, so they are weighted by MULTIPLIER.
    """
    errors, weights = row.metrics.get("errors", {}), {"q": 1.0, "v": 1.0, "lam": MULTIPLIER, "mu": MULTIPLIER}
    found = [(weights[name], errors[name]["max_scaled"]) for name in weights if name in errors]
    if not found or any(error is None for _, error in found):
        return None
    return max(weight * error for weight, error in found)


def _verdict(rows: list[RunRow]) -> Verdict:
    solved = [row for row in rows if row.success]
    known = [(error, row) for row in solved if (error := error_of(row)) is not None]
    if not solved:
        return Verdict(rows[-1], Kind.declined if rows[-1].status == "declined" else Kind.failed)
    if not known:
        return Verdict(solved[-1], Kind.unknown)
    known.sort(key=lambda pair: effort(pair[1]))
    error, best = known[-1]  # the tightest
    digits = best.metrics["errors"].get("digits")
    bar = 0.0 if digits is None else 10.0**-digits
    if error <= max(AGREEMENT_OF_STEPS if stepped(best.solver) else AGREEMENT, LIMIT * bar):
        return Verdict(best, Kind.agrees, error)
    if len(known) > 1 and error <= CONVERGING * known[-2][0] and error <= NEAR:
        return Verdict(best, Kind.converges, error)
    cut = [row for row in rows if row.status in BUDGETS and effort(row) > effort(best)]
    alone = cut and len(known) == 1 and error <= NEAR  # nothing tells whether it would fall
    return Verdict(best, Kind.unfinished if alone else Kind.disagrees, error)


def short(solver: str) -> str:
    """Return a short column heading for a spec: ``ida ggl``."""
    spec = parse_spec(solver)
    words = [str(value) for name, value in spec.arguments.items() if not (name == "form" and value == "ode")]
    return " ".join([spec.name, *words])


def effort(row: RunRow) -> float:
    """Return a number that grows with the tightness of the request."""
    asked = row.request
    return float(asked["steps"]) if asked["steps"] is not None else -float(asked["rtol"] or 0.0)


def claim(id: str, text: str, measured: str | float, bound: object, passed: bool | None) -> Row:
    """Return a claim about the problem whose name ``id`` begins with."""
    return Row(id=id, claim=f"{id.rpartition('/')[0]}: {text}", measured=measured, bound=str(bound), passed=passed)


def nobody_disagrees(problem: str, own: list[Verdict], text: str) -> Row:
    """Return the claim that no solver disagrees, from the verdicts on one problem."""
    wrong = [f"{v.solver} {v.error:.1e}" for v in own if v.kind is Kind.disagrees]
    return claim(f"{problem}/agree", text, "; ".join(wrong) or "none", "none", not wrong)


def evidence_rows(verdicts: list[Verdict], reasons: dict[str, str], makers: frozenset[str] = frozenset()) -> list[Row]:
    """Return rows per problem: no solver disagrees, and enough agree or a reason is known (``reasons``: problem -> why
    fewer).

    ``makers`` (canonical specs) made the references and do not count among those that agree.
    """
    rows = []
    for problem in dict.fromkeys(verdict.problem for verdict in verdicts):
        own = [verdict for verdict in verdicts if verdict.problem == problem]
        agree = [v for v in own if v.kind is Kind.agrees and not stepped(v.solver) and v.solver not in makers]
        few, reason = len(agree) < MIN_AGREEING, reasons.get(problem, "")
        measured = f"{len(agree)}" + (f": {reason}" if few and reason else "")
        enough = f"at least {MIN_AGREEING} pairs agree to {AGREEMENT:g}, or a reason is known"
        steps = [verdict for verdict in own if verdict.solver == "hht"]
        shown = "; ".join(f"{v.error:.1e}" if v.error is not None else v.row.status for v in steps)
        good = any(verdict.kind is Kind.agrees for verdict in steps)
        constant = f"HHT at constant steps agrees to {AGREEMENT_OF_STEPS:g}"
        rows += [
            nobody_disagrees(problem, own, "no pair disagrees with the reference"),
            claim(f"{problem}/pairs", enough, measured, MIN_AGREEING, not few or bool(reason)),
            claim(f"{problem}/hht", constant, shown, f"{AGREEMENT_OF_STEPS:g}", good),
        ]
    return rows
