"""The rules that the rows were made by, printed with every report; each follows from the rows."""

from __future__ import annotations

from collections.abc import Sequence

from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.cells import Point, Rules
from hhtbench.campaign.analysis.fronts import BOUNDS, SAME, level_of, targets_of
from hhtbench.campaign.analysis.ladder import FIRST, MAX_FACTOR, STANDSTILL
from hhtbench.campaign.store.rows import RunRow
from hhtbench.report.words import listed, plural, seconds, times


def rules(rows: Sequence[RunRow]) -> list[str]:
    """One sentence or two for each rule."""
    runs = analysis.points(rows)
    made = [*_ladder(runs), _targets(runs), _references(rows, runs)]
    return [*made, _drift(), *_clock(rows, runs), _held_out(runs)]


def campaign_line(rows: Sequence[RunRow]) -> str:
    """Problems, solvers, errors asked for and limits of a campaign, in a line."""
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
        return ["The settings were given and not refined: a finer setting might reach an error that no run reaches."]
    return [
        f"Every solver starts at a relative tolerance of {FIRST['rtol']:g}, or with {1 / FIRST['steps']:.0f} steps. Its "
        f"errors so far determine the next setting, at most {MAX_FACTOR['rtol']:g} times finer "
        f"({MAX_FACTOR['steps']:g} times more steps).",
        *(_budget(one) for one in found),
    ]


def _budget(one: Rules) -> str:
    return (
        f"Limits of the campaign, for every solver on every problem: {plural(one.refinements, 'run')}, {one.max_seconds:g} "
        f"s a run, {one.pair_seconds:g} s in all. A solver stops earlier when all errors are reached, when "
        f"{STANDSTILL['rtol']} finer runs in a row bring no gain, or when runs fail."
    )


def _targets(runs: Sequence[Point]) -> str:
    targets = listed([f"{target:.0e}" for target in targets_of(runs)])
    asked = any(run.rules is not None for run in runs)
    head = "Solvers are asked for the errors" if asked else "No error was asked for; costs are compared at"
    return (
        f"{head} {targets}. An error is the achieved one: the largest of q and v over the compared times, scaled by the "
        "problem's own sizes. No ranking uses tolerances."
    )


def _references(rows: Sequence[RunRow], runs: Sequence[Point]) -> str:
    against = [(row.metrics.get("errors") or {}).get("against") for row in rows]
    closed = len({row.problem for row, kind in zip(rows, against, strict=True) if kind == "exact"})
    stored = len({row.problem for row, kind in zip(rows, against, strict=True) if kind == "reference"})
    limits = sorted({run.limit for run in runs if run.limit})
    bars = f" ({limits[0]:.0e} to {limits[-1]:.0e})" if limits else ""
    return (
        f"Errors are taken against a closed solution on {plural(closed, 'problem')}, and on {stored} against a reference on "
        f"which two families of methods agree. Errors below the reference's own error bar{bars} are not ranked."
    )


def _drift() -> str:
    bounds = listed(["none" if bound is None else f"{bound:.0e}" for bound in BOUNDS])
    return (
        "Drift of the constraints is no error, and no solver is left out for it. Comparisons are made for these bounds of "
        f"the scaled drift of position and velocity over all steps: {bounds}."
    )


def _clock(rows: Sequence[RunRow], runs: Sequence[Point]) -> list[str]:
    timed = [row for row in rows if row.timing.get("rounds_s")]
    if not timed:
        return ["Times were taken while other runs used the machine."]
    passes = max(len(row.timing["rounds_s"]) for row in timed)
    least = min(max(row.timing["wall_s"], row.timing["median_s"]) * row.timing["solves"] for row in timed)
    level = level_of(runs)
    return [
        "Time is the processor time of a solve alone on a core, without output, start and compilation. It is the best of "
        f"{plural(passes, 'pass')} over all runs; short solves are repeated until a reading lasts {seconds(least)} or more.",
        f"Two times are equal within noise when they differ by less than a factor {times(level)}: {SAME:.1%} of the repeats "
        "of one solve do.",
    ]


def _held_out(runs: Sequence[Point]) -> str:
    names = list(dict.fromkeys(run.problem for run in runs if run.held_out))
    if not names:
        return "No problem is held out: all were used to choose default settings."
    return f"Held out, that is not used to choose default settings: {listed(names)}."
