"""The rules of fairness that the rows were made by, printed with every report; each is read off the rows."""

from __future__ import annotations

from collections.abc import Sequence

from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.cells import Point, Rules, family
from hhtbench.campaign.analysis.fronts import BOUNDS, SAME, level_of, targets_of
from hhtbench.campaign.analysis.ladder import FIRST, MAX_FACTOR, STANDSTILL
from hhtbench.campaign.store.rows import RunRow
from hhtbench.report.words import listed, plural, seconds, times


def rules(rows: Sequence[RunRow]) -> list[str]:
    """One sentence or two for each rule."""
    runs = analysis.points(rows)
    made = [*_ladder(runs), _targets(runs), _references(rows, runs), _coordinates(runs)]
    return [*made, _drift(), *_clock(rows, runs), _held_out(runs)]


def campaign_told(rows: Sequence[RunRow]) -> str:
    """What was asked of whom, in a line."""
    runs = analysis.points(rows)
    found = list(dict.fromkeys(run.rules for run in runs if run.rules is not None))
    limits = "; ".join(
        f"at most {plural(one.refinements, 'run')}, {one.max_seconds:g} s each, {one.pair_seconds:g} s in all"
        for one in found
    )
    head = f"Campaign: {plural(len(analysis.problems(rows)), 'problem')}, {plural(len(analysis.entries(rows)), 'solver')}"
    if not limits:
        given = sorted({(run.setting.kind, -run.setting.value, run.setting.text) for run in runs})
        return f"{head}, settings given: {', '.join(text for *_, text in given)}."
    asked = ", ".join(f"{target:.0e}" for target in targets_of(runs))
    return f"{head}, errors {asked}; of one solver on one problem {limits}."


def _ladder(runs: Sequence[Point]) -> list[str]:
    found = list(dict.fromkeys(run.rules for run in runs if run.rules is not None))
    if not found:
        return [
            "The settings were given, not refined: where no run reaches an error a finer one might, at a cost not known."
        ]
    return [
        f"Every solver starts at a relative tolerance of {FIRST['rtol']:g}, or with {1 / FIRST['steps']:.0f} steps, and is "
        "refined alike: the next setting follows from its errors so far, aims at the loosest error not reached, and is at "
        f"most {MAX_FACTOR['rtol']:g} times finer ({MAX_FACTOR['steps']:g} times more steps).",
        *(_budget(one) for one in found),
    ]


def _budget(one: Rules) -> str:
    return (
        f"Every solver is given the same: {plural(one.refinements, 'run')} on a problem at most, {one.max_seconds:g} s "
        f"each, {one.pair_seconds:g} s of solving in all. It ends sooner where all errors are reached, "
        f"{STANDSTILL['rtol']} finer runs in a row are no better, or runs fail. What it has not reached by then is not "
        "reached; where a factor is told all the same, what its finest run took is a lower bound of its cost."
    )


def _targets(runs: Sequence[Point]) -> str:
    targets = listed([f"{target:.0e}" for target in targets_of(runs)])
    asked = any(run.rules is not None for run in runs)
    head = "Errors to reach" if asked else "Nobody was asked for an error; costs are compared at"
    return (
        f"{head}: {targets}. They are achieved errors, the largest of q and v over the compared times, scaled by "
        "the problem's own sizes; tolerances play no part in any ranking."
    )


def _references(rows: Sequence[RunRow], runs: Sequence[Point]) -> str:
    against = [(row.metrics.get("errors") or {}).get("against") for row in rows]
    closed = len({row.problem for row, kind in zip(rows, against, strict=True) if kind == "exact"})
    stored = len({row.problem for row, kind in zip(rows, against, strict=True) if kind == "reference"})
    limits = sorted({run.limit for run in runs if run.limit})
    bars = f" (here {limits[0]:.0e} to {limits[-1]:.0e})" if limits else ""
    return (
        f"Truth: a closed solution on {plural(closed, 'problem')}, on {stored} a reference that two method families on two "
        "forms of the equations agree on; none rests on the solver under test or its family alone. Errors below the "
        f"reference's own error bar{bars} are judged of nobody."
    )


def _coordinates(runs: Sequence[Point]) -> str:
    minimal = [run for run in runs if run.entry.startswith("minimal(") and run.status != "declined"]
    if not minimal:
        return "No solver was run on minimal coordinates."
    who = listed(list(dict.fromkeys(family(run.entry) for run in minimal)))
    where = listed(list(dict.fromkeys(run.problem for run in minimal)))
    return f"Minimal coordinates are for all who can use them: {who}, on {where}."


def _drift() -> str:
    bounds = listed(["none" if bound is None else f"{bound:.0e}" for bound in BOUNDS])
    return (
        f"Drift of the constraints is no error and no reason to leave a solver out: comparisons stand side by side for the "
        f"bounds {bounds}, scaled, of position and velocity over all steps."
    )


def _clock(rows: Sequence[RunRow], runs: Sequence[Point]) -> list[str]:
    timed = [row for row in rows if row.timing.get("rounds_s")]
    if not timed:
        return ["Times were taken beside other work."]
    rounds = max(len(row.timing["rounds_s"]) for row in timed)
    least = min(max(row.timing["wall_s"], row.timing["median_s"]) * row.timing["solves"] for row in timed)
    level = level_of(runs)
    return [
        "Time is processor time of a solve without output on the way, alone on a core; starts and compilation apart. The "
        f"best of {plural(rounds, 'round')} over all runs; a short solve is repeated within a reading, the shortest of "
        f"which lasted {seconds(least)}.",
        f"Level are costs within a factor {times(level)} of one another: {SAME:.1%} of the repeats of one and the same "
        "solve differ by less.",
    ]


def _held_out(runs: Sequence[Point]) -> str:
    names = list(dict.fromkeys(run.problem for run in runs if run.held_out))
    if not names:
        return "No problem is held out: all were known while defaults were tuned."
    return f"Held out, never looked at while defaults were tuned: {listed(names)}."
