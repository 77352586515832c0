"""Choose the next tolerance or step number of one solver on one problem, or state why the refinement ends.

The same for every solver: it starts at ``FIRST``; every next setting is finer and aims at the loosest target not reached,
by the slope of the errors so far.  It ends when all targets are reached or at a stated cap.  Only the runs and the rules
decide, so that a resumed campaign asks for nothing twice, and the report can say why a target was not reached.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hhtbench.campaign.analysis.cells import Point, Rules

FIRST = {"rtol": 3e-2, "steps": 1.0 / 10}  #: coarsest setting, of every solver; a number of steps by its inverse
FINEST = {"rtol": 1e-13, "steps": 1e-9}  # SciPy takes no smaller tolerance than 2e-14
SLOPES = {
    "rtol": (0.5, 1.5),
    "steps": (1.0, 4.0),
}  # bounds of the slope of error against setting, both logarithmic; measured slopes are clipped to them
USUAL = {"rtol": 1.0, "steps": 2.0}  # slope before two errors are known
MAX_FACTOR = {"rtol": 30.0, "steps": 10.0}  # largest refinement factor between two runs
MIN_FACTOR = 1.4  # smallest refinement factor: less would hardly change the error
AGAIN = 10.0  # refinement factor after a failure while no run has succeeded
BEYOND = 3.0  # refinement factor past a failure, which may be a single one
AIM = 0.6  # aim at this share of the target: a run that misses it by little costs another
BETTER = 0.9  # an error below this share of the best so far counts as an improvement
STANDSTILL = {"rtol": 3, "steps": 2}  # finer runs in a row without improvement that end a ladder, each ``MAX_FACTOR`` finer
FAILURES = 2  # runs finer than the finest success that fail, the same
EARLY = 6  # runs that fail before any has succeeded, the same: a loose tolerance may be too loose for what a check bears
BROKEN = ("crashed", "out_of_memory")  #: statuses that come from no tolerance: ``FAILURES`` of them end a ladder at once
CAPS = ("deadline", "max_steps", "evaluation_budget")  #: statuses of a run that used up what a run may use


@dataclass(frozen=True, kw_only=True)
class End:
    """Reason why the refinement ends."""

    kind: str  #: "reached", "unjudged", "refused", "capped", "fails" or "standstill"
    text: str


@dataclass(frozen=True, kw_only=True)
class Next:
    """Setting and time limit of the next run."""

    value: float  #: relative tolerance, or 1 / number of steps
    seconds: float  #: time limit [s]


def next_setting(runs: Sequence[Point], rules: Rules, kind: str = "rtol") -> Next | End:
    """Return the next run after ``runs`` (any order) of one solver on one problem, or the End; ``kind``: rtol or steps."""
    known = sorted(runs, key=lambda run: -run.setting.value)
    if not known:
        return Next(value=FIRST[kind], seconds=min(rules.max_seconds, rules.pair_seconds))
    last, allowed = known[-1], _allowed(known, rules)
    end = _ended(known, rules, kind) or _out_of_budget(known, rules, allowed)
    if end is not None:
        return end
    value = _finer(known, rules, kind)
    if value < FINEST[kind]:
        return End(kind="capped", text=f"no finer setting than {last.setting.text} is asked for")
    return Next(value=value, seconds=allowed)


def _ended(known: Sequence[Point], rules: Rules, kind: str) -> End | None:
    """Return the End if the refinement is finished (reached, refused, failed or no better); else None."""
    last = known[-1]
    good = [run for run in known if run.success]
    if last.status == "declined":
        return End(kind="refused", text=f"refused: {last.message}")
    if last.status in CAPS:
        return End(kind="capped", text=_cap(last))
    if good and all(run.error is None for run in good):
        return End(kind="unjudged", text="no exact solution or reference to compare with")
    if not _open(known, rules):
        return End(kind="reached", text="every target that can be judged is reached")
    if len(_failures(known)) >= (FAILURES if good or last.status in BROKEN else EARLY):
        return _failed(known)
    if _no_better(good, rules) >= STANDSTILL[kind]:
        text = f"no better when finer: error {good[-1].error:.2g} at {good[-1].setting.text}"
        return End(kind="standstill", text=text)
    return None


def _cap(last: Point) -> str:
    """Name the budget that was used up; the row holds the solver's own message."""
    if last.status == "deadline" and last.spent is not None:
        return f"more than {last.spent:.2g} s at {last.setting.text}"
    return f"{last.status} at {last.setting.text}"


def _failures(known: Sequence[Point]) -> Sequence[Point]:
    """Return the runs finer than the finest success."""
    places = [i for i, run in enumerate(known) if run.success]
    return known[places[-1] + 1 :] if places else known


def _failed(known: Sequence[Point]) -> End:
    failed = _failures(known)
    settings = f"{failed[0].setting.text} to {failed[-1].setting.text}" if len(failed) > 1 else failed[0].setting.text
    return End(kind="fails", text=f"{failed[-1].status} at {settings}: {failed[-1].message}")


def _out_of_budget(known: Sequence[Point], rules: Rules, allowed: float) -> End | None:
    if len(known) >= rules.refinements:
        return End(kind="capped", text=f"{rules.refinements} runs, the most of one solver on one problem")
    if allowed <= (known[-1].spent or 0.0):  # a finer run takes longer
        return End(
            kind="capped",
            text=f"what is left of {rules.pair_seconds:g} s is less than the run at {known[-1].setting.text} took",
        )
    return None


def _allowed(known: Sequence[Point], rules: Rules) -> float:
    """Return the time limit of the next run [s]."""
    return min(rules.max_seconds, rules.pair_seconds - sum(run.spent or 0.0 for run in known))


def _open(known: Sequence[Point], rules: Rules) -> list[float]:
    """Return the targets that the reference can judge and no run has reached, loosest first."""
    limit = max(run.limit for run in known)
    best = min((run.error for run in known if run.error is not None), default=math.inf)
    return sorted((target for target in rules.accuracies if limit <= target < best), reverse=True)


def _no_better(good: Sequence[Point], rules: Rules) -> int:
    """Count the last runs that are no better than the best before them, once that had reached a target."""
    best, count = math.inf, 0
    for error in (run.error for run in good if run.error is not None):
        count = count + 1 if best <= max(rules.accuracies) and error > BETTER * best else 0
        best = min(best, error)
    return count


def _finer(known: Sequence[Point], rules: Rules, kind: str) -> float:
    """Return the next setting by the slope; between the last success and a failure, or beyond the failure if they are
    close.
    """
    good, failed = [run for run in known if run.success], _failures(known)
    if not good:
        return rounded(known[-1].setting.value / AGAIN, known[-1].setting.value, kind)
    finest = good[-1].setting.value
    value = rounded(finest / _factor(known, rules, kind), finest, kind)
    if not failed or value > MIN_FACTOR * failed[0].setting.value:
        return value
    broken = failed[0].setting.value
    if finest > MIN_FACTOR**2 * broken:
        return rounded(math.sqrt(finest * broken), finest, kind)
    return rounded(broken / BEYOND, broken, kind)


def _factor(known: Sequence[Point], rules: Rules, kind: str) -> float:
    """Return the ratio of the finest success's setting to the next one."""
    good = [run for run in known if run.success]
    last = good[-1]
    if not last.error or last.error > max(rules.accuracies) or _no_better(good, rules):
        return MAX_FACTOR[kind]
    ratio = last.error / (AIM * _open(known, rules)[0])
    return min(max(ratio ** (1.0 / _slope(known, kind)), MIN_FACTOR), MAX_FACTOR[kind])


def _slope(known: Sequence[Point], kind: str) -> float:
    """Return the slope of log error against log setting from the last two runs, clipped to ``SLOPES``."""
    errors = [(run.setting.value, run.error) for run in known if run.error]
    if len(errors) < 2:
        return USUAL[kind]
    (coarse, before), (fine, after) = errors[-2:]
    low, high = SLOPES[kind]
    return min(max(math.log(before / after) / math.log(coarse / fine), low), high)


def rounded(value: float, before: float, kind: str) -> float:
    """Round a setting to two digits, finer than ``before``; a number of steps is whole."""
    if kind == "steps":
        count = math.ceil(float(f"{1.0 / value:.1e}"))
        return 1.0 / max(count, round(1.0 / before) + 1)
    short = float(f"{value:.1e}")
    return short if short < before else value
