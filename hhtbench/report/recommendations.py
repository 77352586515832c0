"""What to take, in sentences that a reader can repeat, and when not to take the solver that is cheapest most often."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence

from hhtbench.campaign.analysis.cells import SUBJECT, family
from hhtbench.campaign.analysis.decision import Choice, Ratio, SolverCosts
from hhtbench.campaign.analysis.fronts import STEADY
from hhtbench.campaign.analysis.kinds import CONSTRAINTS, CONTACT, DAMPERS, SMOOTH, UNTOLD, VIBRATIONS, Kind
from hhtbench.campaign.analysis.missing import NOT_RUN
from hhtbench.report.decisions import Choices, basis, best_subject, ranked, reach_of, same_cost, why
from hhtbench.report.methods import by_method
from hhtbench.report.words import KINDS, listed, plural

USUAL_ERROR = 1e-4
MIN_PROBLEMS = 3  # fewer are named as a hint
SCENES = {
    CONSTRAINTS[True, False]: "joints",
    CONSTRAINTS[True, True]: "joints and rolling contacts",
    CONSTRAINTS[False, True]: "rolling or skating contacts",
    CONSTRAINTS[False, False]: "unconstrained systems",
}
FORCES = {
    SMOOTH: " with smooth forces",
    VIBRATIONS: " with stiff vibrations",
    DAMPERS: " with stiff dampers",
    CONTACT: " with contact",
    UNTOLD: "",
}


def recommendations(choices: Choices, level: float, held_out: Collection[str]) -> tuple[str, ...]:
    """When to take which kind of method, by all rows of the table; a sentence or two for each kind of problem, at one
    error; then when not to take the winner.
    """
    found, steady = choices["time", None], choices["time", STEADY]
    targets = sorted({choice.target for choice in found})
    if not targets:
        return ()
    usual = USUAL_ERROR if USUAL_ERROR in targets else targets[len(targets) // 2]
    kept = {choice.kind: choice for choice in steady if choice.target == usual}
    own = [choice for choice in found if choice.target == usual]
    sentences = [_sentence(choice, kept.get(choice.kind), level, held_out) for choice in own]
    return (*by_method(found, _scene, _power), *sentences, *_exceptions(found, steady, level))


def _power(value: float) -> str:
    """``1e-4``."""
    return f"{value:.0e}".replace("e-0", "e-")


def _scene(kind: Kind) -> str:
    nonlinear = " and reactions nonlinear in the multipliers" * kind.nonlinear
    return SCENES.get(kind.constraints, "problems of unknown constraints") + FORCES[kind.forces] + nonlinear


def _sentence(choice: Choice, steady: Choice | None, level: float, held_out: Collection[str]) -> str:
    scene = f"{_scene(choice.kind)} ({', '.join(basis(choice.problems, held_out))})"
    order = ranked(choice)
    if not order:
        return f"For {scene} no solver reaches an error of {_power(choice.target)}."
    first, best = order[0], best_subject(choice)
    reach = f" It reaches this error on {reach_of(first)} problems." * bool(first.missing)
    head = f"For {scene} at an error of {_power(choice.target)} take {first.entry}"
    return f"{head}; {_versus_subject(first, best, order[1:], level)}.{reach}{_steadiness(first, steady)}"


def _versus_subject(first: SolverCosts, best: SolverCosts | None, others: Sequence[SolverCosts], level: float) -> str:
    """How the cheapest stands to HHT; where it is HHT, to the best of the others."""
    rival = best
    if family(first.entry) == SUBJECT:
        rival = next((place for place in others if family(place.entry) != SUBJECT), None)
    if rival is None:
        return "no other solver reaches it" if rival is not best else "HHT was not run"
    name = f"HHT ({rival.entry})" if rival is best else rival.entry
    ratio = rival.over(first)
    if ratio is None:
        return f"{name} does not reach it ({why(rival)})" if not rival.costs else f"{name} reaches it on other problems only"
    if ratio.within(level):
        text = f"{name} costs about the same"
    elif ratio.value < 1 / level:
        text = f"{name} is {_times(ratio, inverse=True)} where both reach it"
    else:
        text = f"it is {_times(ratio)} than {name}"
    joined = ", which" if text.endswith(name) else " but"
    return text + f"{joined} reaches it on {reach_of(rival)} problems" * bool(rival.missing)


def _times(ratio: Ratio, inverse: bool = False) -> str:
    """``about 8 times cheaper``; ``inverse``: of the dearer over the cheaper one's side."""
    factor = 1 / ratio.value if inverse else ratio.value
    bounds = (ratio.at_least, ratio.at_most) if inverse else (ratio.at_most, ratio.at_least)
    return f"{ ({(True, False): 'up to', (False, True): 'at least'}.get(bounds, 'about')) } {_number(factor)} times cheaper"


def _number(factor: float) -> str:
    return f"{factor:,.0f}" if factor >= 3 else f"{factor:.1f}"


def _steadiness(first: SolverCosts, steady: Choice | None) -> str:
    """Whether the cheapest keeps the drift of the constraints, and whom to take where it does not."""
    if steady is None:
        return ""
    kept, bound = ranked(steady), f"drift below {_power(STEADY)}"
    own = next((place for place in kept if place.entry == first.entry), None)
    if own is None or len(own.costs) < len(first.costs):
        return f" It does not keep {bound}; {f'{kept[0].entry} does' if kept else 'nobody does'}."
    ratio = own.over(first)
    dearer = (
        "" if ratio is None or same_cost(own, first) else f" with tighter settings, at {_number(ratio.value)} times the cost"
    )
    return f" It keeps {bound}{dearer}."


def _exceptions(found: Sequence[Choice], steady: Sequence[Choice], level: float) -> list[str]:
    """When not to take the solver that is cheapest most often; all lines of the table count."""
    firsts = {(choice.kind, choice.target): ranked(choice)[0].entry for choice in found if ranked(choice)}
    if not firsts:
        return []
    (winner, number), *_ = Counter(firsts.values()).most_common(1)
    cases: dict[tuple[str, str], list[str]] = {}
    for choice in found:
        reason = _against(winner, choice, level)
        if reason:
            cases.setdefault((_scene(choice.kind), reason), []).append(f"{_power(choice.target)}")
    parts = [f"for {scene} at {listed(errors)} ({reason})" for (scene, reason), errors in cases.items()]
    drifting = dict.fromkeys(_scene(choice.kind) for choice in steady if _drifts(winner, choice, firsts))
    parts += [f"for {listed([*drifting])} where drift must stay below {_power(STEADY)}"] if drifting else []
    head = f"{winner} is the cheapest in {number} of {len(found)} rows of the table"
    sentences = [f"{head}. Do not take it {'; '.join(parts)}." if parts else f"{head}, and no row speaks against it."]
    few = {choice.kind for choice in found if len(choice.problems) < MIN_PROBLEMS}
    if few:
        sentences.append(f"Rows on fewer than {MIN_PROBLEMS} problems ({plural(len(few), 'kind')}) are a hint, not a proof.")
    return sentences


def _drifts(winner: str, choice: Choice, firsts: Mapping[tuple[Kind, float], str]) -> bool:
    """Whether the winner is the cheapest there only while the drift has no bound."""
    order = ranked(choice)
    return firsts.get((choice.kind, choice.target)) == winner and not (order and order[0].entry == winner)


def _against(winner: str, choice: Choice, level: float) -> str:
    """Why not to take the winner there; "" where it is the cheapest, or equal to it."""
    order = ranked(choice)
    if not order or order[0].entry == winner:
        return ""
    other = "HHT" if family(order[0].entry) == SUBJECT else order[0].entry
    place = next((place for place in choice.places if place.entry == winner), None)
    if place is None or not place.costs:
        return f"{KINDS[NOT_RUN] if place is None else why(place)}; take {other}"
    ratio = place.over(order[0])
    if ratio is None or len(place.costs) < len(order[0].costs):
        return f"it reaches {reach_of(place)} problems; take {other}"
    unclear = ratio.value <= level and (ratio.at_most or not ratio.at_least)
    return "" if unclear else f"{other} is {_times(ratio)}"
