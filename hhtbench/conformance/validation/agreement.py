"""Compare solvers by the states in their rows, and take their differences as errors where no solution is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hhtbench.campaign.store import RunRow
from hhtbench.catalogue.specs import parse_spec
from hhtbench.conformance import Agreement
from hhtbench.conformance.pairwise import Motion, agreement_of
from hhtbench.conformance.validation.verdict import AGREEMENT, Kind, Verdict, claim, effort, nobody_disagrees, short
from hhtbench.protocol.evidence import Row
from hhtbench.protocol.problem import Problem

FAMILIES = 2  # solvers of so many libraries must agree where there is no reference
NO_REFERENCE = "no reference: judged by agreement"


@dataclass(frozen=True)
class Compared:
    """Rows of one problem after pairwise comparison."""

    problem: str  #: canonical spec
    rows: tuple[RunRow, ...]  #: with errors, also where no solution is known
    agreement: Agreement
    known: bool  #: there is a reference or a closed solution


def compare_rows(name: str, problem: Problem, rows: Sequence[RunRow]) -> Compared:
    """Compare the tightest success of every solver with those of the others.

    If no solution is known, the errors of all rows are their differences from the solver with the smallest median
    difference; its own error is its difference from the nearest solver of another library.
    """
    own = [row for row in rows if row.problem == name]
    best = {row.solver: row for row in sorted(own, key=effort) if row.success and "states" in row.series}
    motions = {short(solver): _motion(row) for solver, row in best.items()}
    left_out = {short(row.solver): f"{row.status}: {row.message}" for row in own if row.solver not in best}
    found = agreement_of(motions, problem.scales, left_out)
    known = problem.exact is not None or problem.reference is not None
    if known or len(best) < 2:
        return Compared(name, tuple(own), found, known)
    middle = list(best.values())[found.middle()]
    return Compared(name, tuple(_judged(row, middle, found, list(best), problem) for row in own), found, known)


def _motion(row: RunRow) -> Motion:
    return {name: np.array(row.series["states"][name], dtype=float) for name in ("q", "v")}


def _judged(row: RunRow, middle: RunRow, found: Agreement, solvers: list[str], problem: Problem) -> RunRow:
    """Return the row with its difference from the middle solver's row as error."""
    if "states" not in row.series or not row.success:
        return row
    if row.key == middle.key:
        at = found.middle()
        others = [i for i, solver in enumerate(solvers) if family(solver) != family(row.solver)]
        error = float(min((found.matrix[at, i] for i in others), default=np.inf))
    else:
        error = agreement_of({"row": _motion(row), "middle": _motion(middle)}, problem.scales).spread
    entry = {"max_scaled": error}
    return replace(row, metrics={**row.metrics, "errors": {"against": "agreement", "digits": None, "q": entry, "v": entry}})


def family(solver: str) -> str:
    """Return the library name of a spec."""
    return parse_spec(solver).name


def agreement_rows(compared: Compared, verdicts: Sequence[Verdict]) -> list[Row]:
    """Return claims about a problem without reference: no solver disagrees, two libraries agree; and their spread."""
    name = compared.problem
    own = [verdict for verdict in verdicts if verdict.problem == name]
    agree = [verdict.solver for verdict in own if verdict.kind is Kind.agrees]
    families = sorted({family(solver) for solver in agree})
    names = list(compared.agreement.names)
    chosen = [names.index(short(solver)) for solver in agree if short(solver) in names]
    spread = float(np.max(compared.agreement.matrix[np.ix_(chosen, chosen)], initial=0.0))
    few = f"solvers of at least {FAMILIES} libraries agree to {AGREEMENT:g}"
    apart = "those that agree are apart by, an estimate of their error"
    return [
        nobody_disagrees(name, own, f"no solver disagrees with the others ({NO_REFERENCE})"),
        claim(f"{name}/families", few, ", ".join(families) or "none", FAMILIES, len(families) >= FAMILIES),
        claim(f"{name}/spread", apart, spread, "not judged", None),
    ]


def matrix_text(compared: Compared) -> str:
    """Format the pairwise differences as Markdown."""
    judged = "" if compared.known else f"{NO_REFERENCE}; "
    difference = "Largest difference of q and v of two solvers' tightest runs, over their size"
    return "\n".join(
        [
            f"## {compared.problem}: who agrees with whom",
            "",
            f"{difference}; {judged}largest of all {compared.agreement.spread:.1e}.",
            "",
            compared.agreement.table("github"),
            "",
        ]
    )
