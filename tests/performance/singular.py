"""Singular positions passed: four bars of several sizes from many phases of their motion; 1 if one takes another branch.

Every run is a second of the motion and meets one or two positions at which every window may go on as an antiparallelogram;
the closed solution says what is right.  Of each size the table counts right ends, refusals that name the lost rank, other
refusals and wrong branches, and of the first how many needed a step across.  Less than 99 % of right ends and named
refusals is a failure too.
``python -m tests.performance.singular [--phases 50] [--windows 1 3 5 8] [--alpha 0]``: some ten minutes for a size.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections import Counter
from dataclasses import replace

import numpy as np

import hhtbench as hb

TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 3e-7, 1e-7)
WINDOWS = (1, 3, 5, 8)
SPREAD, SPAN = 0.6, 1.0  # [s]: starts lie before the first position at 0.7 s, and every run meets it
ELSEWHERE = 0.1  # [m] from the closed solution, in any row that is looked at; other branches are 1 m away
ROWS = 100  # that are looked at, about, of every run
ENOUGH = 0.99  # of right ends and named refusals


def problem_at(windows: int, phase: float) -> hb.Problem:
    """Four bars from where their motion is after ``phase`` [s]."""
    whole = hb.load_problem(f"four_bars(n_windows={windows}, t_end=3.0)")
    start = whole.exact(phase)
    return replace(whole, q0=start.q, v0=start.v, t_span=(phase, phase + SPAN), reference=None)


def kind_of(given: hb.Problem, found: hb.Solution) -> str:
    """How the run ended."""
    looked_at = slice(None, None, -max(1, found.t.size // ROWS))  # the last is one of them
    rows = zip(found.t[looked_at], found.q[looked_at], strict=True)
    off = max((float(np.abs(q - given.exact(float(t)).q).max()) for t, q in rows), default=0.0)
    if not off <= ELSEWHERE:
        return "wrong"
    if not found.success:
        return "named" if "lose rank" in found.message else "other"
    return "across" if "across a singular position" in found.message else "right"


def counted(windows: int, phases: int, alpha: float, tolerances: tuple[float, ...] = TOLERANCES) -> Counter[str]:
    """Ends of the runs of one size, by their kind."""
    kinds: Counter[str] = Counter()
    for phase in SPREAD * np.arange(phases) / phases:
        given = problem_at(windows, float(phase))
        for rtol in tolerances:
            kinds[kind_of(given, hb.solve(given, hb.load_solver("hht", alpha=alpha), rtol=rtol))] += 1
    return kinds


def good(kinds: Counter[str]) -> float:
    """The share of right ends and named refusals."""
    return (kinds["right"] + kinds["across"] + kinds["named"]) / kinds.total()


def passed(kinds: Counter[str]) -> bool:
    """Whether no run takes another branch and ``ENOUGH`` of them end well."""
    return not kinds["wrong"] and good(kinds) >= ENOUGH


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--phases", type=int, default=50)
    parser.add_argument("--windows", type=int, nargs="+", default=list(WINDOWS))
    parser.add_argument("--alpha", type=float, default=0.0)
    asked = parser.parse_args(arguments)
    warnings.simplefilter("ignore")
    total: Counter[str] = Counter()
    sys.stdout.write("windows  runs  right  across  named  other  wrong\n")
    for windows in [*asked.windows, 0]:
        kinds = counted(windows, asked.phases, asked.alpha) if windows else total
        total = total + kinds if windows else total
        numbers = [
            kinds.total(),
            kinds["right"] + kinds["across"],
            *(kinds[x] for x in ("across", "named", "other", "wrong")),
        ]
        sys.stdout.write(f"{windows or 'all':>7}  " + "  ".join(f"{x:5d}" for x in numbers) + "\n")
        sys.stdout.flush()
    sys.stdout.write(f"right or named: {good(total):.2%}; wrong branch: {total['wrong']}\n")
    return 0 if passed(total) else 1


if __name__ == "__main__":
    sys.exit(main())
