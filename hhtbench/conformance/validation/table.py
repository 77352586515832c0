"""The solvability matrix as Markdown: accuracy, evaluations and failures of each solver on each problem."""

from __future__ import annotations

from math import log10

from tabulate import tabulate

from hhtbench.conformance.validation.plan import STEPS
from hhtbench.conformance.validation.verdict import AGREEMENT, AGREEMENT_OF_STEPS, Kind, Verdict, short

MOST_REASONS = 60  # distinct messages listed under the tables


def solvability(verdicts: list[Verdict], command: str) -> str:
    """Format both matrices and the reasons of failures."""
    problems = list(dict.fromkeys(verdict.problem for verdict in verdicts))
    solvers = list(dict.fromkeys(verdict.solver for verdict in verdicts))
    by_pair = {(verdict.problem, verdict.solver): verdict for verdict in verdicts}
    accuracy = [[p, *(_accuracy(by_pair.get((p, s))) for s in solvers)] for p in problems]
    work = [[p, *(_work(by_pair.get((p, s))) for s in solvers)] for p in problems]
    counts = ", ".join(f"{count:,}" for count in STEPS)
    heads = ["problem", *(short(solver) for solver in solvers)]
    return "\n".join(
        [
            "# Who solves what",
            "",
            f"Made by `{command}`. The solvers and forms of the columns at relative tolerances 1e-8 and 1e-10",
            f"(constant steps: {counts}), against certified references or closed solutions, or, where there is",
            "neither, against the solver to which the others are nearest; the tightest counts.",
            "",
            "Collocation and projected made the references, so they do not count among those that agree.",
            "",
            "**Digits**: -log10 of the largest scaled error of q and v (or a hundredth of that of lam and mu) over time.",
            f"Plain: agrees to {AGREEMENT:g} ({AGREEMENT_OF_STEPS:g} at constant steps).",
            "In parentheses: above that, but falling with the tolerance.",
            "`(...)...`: one run above that, and the tighter ones ran out of time.",
            "`!`: disagrees. Words: the status in which every run ended; `-`: declined, with the reason below.",
            "",
            tabulate(accuracy, headers=heads, tablefmt="github", disable_numparse=True),
            "",
            "**Residual evaluations** of the run that counts (`?`: not reported).",
            "",
            tabulate(work, headers=heads, tablefmt="github", disable_numparse=True),
            "",
            "## What did not work, in the solvers' words",
            "",
            *_reasons(verdicts),
            "",
        ]
    )


def _accuracy(verdict: Verdict | None) -> str:
    if verdict is None:
        return ""
    text = digits(verdict.error or 0.0)
    return {
        Kind.failed: verdict.row.status,
        Kind.declined: "-",
        Kind.unknown: "solved",
        Kind.agrees: text,
        Kind.converges: f"({text})",
        Kind.unfinished: f"({text})...",
        Kind.disagrees: f"! {text}",
    }[verdict.kind]


def digits(error: float) -> str:
    """Return -log10 of ``error`` with one decimal."""
    return f"{-log10(max(error, 1e-16)):.1f}"


def _work(verdict: Verdict | None) -> str:
    if verdict is None or verdict.kind in (Kind.failed, Kind.declined):
        return ""
    evaluations = verdict.row.counters.get("residual_evaluations")
    return "?" if evaluations is None else f"{evaluations:,}"


def _reasons(verdicts: list[Verdict]) -> list[str]:
    found: dict[str, list[str]] = {}
    for verdict in verdicts:
        if verdict.kind in (Kind.failed, Kind.declined):
            text = f"{verdict.row.status}: {verdict.row.message}".split("; library")[0]
            found.setdefault(f"{short(verdict.solver)}, {text[:300]}", []).append(verdict.problem)
    lines = [f"- {text}: {', '.join(dict.fromkeys(problems))}" for text, problems in found.items()]
    return lines[:MOST_REASONS] + ([f"- and {len(lines) - MOST_REASONS} more"] if len(lines) > MOST_REASONS else [])
