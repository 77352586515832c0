"""When to take which kind of method: the rows of the table grouped by the kind of their cheapest solver."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hhtbench.campaign.analysis.cells import SUBJECT, family
from hhtbench.campaign.analysis.decision import Choice
from hhtbench.campaign.analysis.kinds import Kind
from hhtbench.report.decisions import ranked
from hhtbench.report.words import listed, plural

HHT, ALPHA, EXPLICIT, BDF, RADAU = "HHT", "another alpha method with constant steps", "an explicit method", "BDF", "Radau"
METHODS = (HHT, ALPHA, EXPLICIT, BDF, RADAU)  # in the order of the sentences
NAMED = {  # by the solver's name, else by a word in its options; what is left takes explicit steps
    SUBJECT: HHT,
    "hht_i3": ALPHA,
    "generalised_alpha": ALPHA,
    "ida": BDF,
    "collocation": RADAU,
}
OPTIONS = {"bdf": BDF, "lsoda": BDF, "radau": RADAU, "kvaerno": RADAU}
BY_DEFAULT = {"cvode": "bdf", "scipy": "radau"}  # methods of solvers whose options name none


def method_of(entry: str) -> str:
    """Kind of method of a solver; LSODA counts as BDF, implicit Runge-Kutta methods as Radau."""
    taken = entry.lower() if "method=" in entry else BY_DEFAULT.get(family(entry), entry)
    options = (method for word, method in OPTIONS.items() if word in taken)
    return NAMED.get(family(entry)) or next(options, EXPLICIT)


def by_method(found: Sequence[Choice], scene: Callable[[Kind], str], power: Callable[[float], str]) -> list[str]:
    """A sentence for each kind of method: scenes and errors at which its best solver is the cheapest, by which factor.

    ``scene`` and ``power`` write a kind of problem and an error.
    """
    takes: dict[str, dict[Kind, list[Choice]]] = {}
    for choice in found:
        if order := ranked(choice):
            takes.setdefault(method_of(order[0].entry), {}).setdefault(choice.kind, []).append(choice)
    ran = {method_of(place.entry) for choice in found for place in choice.places}
    sentences = []
    for method in METHODS:
        parts = [
            f"{scene(kind)} at {listed([power(choice.target) for choice in choices])} ({_factors(choices, method)})"
            for kind, choices in takes.get(method, {}).items()
        ]
        sentences += [f"Take {method} for {'; '.join(parts)}."] * bool(parts)
    never = [method for method in METHODS if method in ran and method not in takes]
    return [*sentences, *[f"No row has {' or '.join(never)} as the cheapest."] * bool(never)]


def _factors(choices: Sequence[Choice], method: str) -> str:
    """What the best solver of another kind of method costs over the cheapest, and on how many problems this rests."""
    ratios = []
    for choice in choices:
        first, *others = ranked(choice)
        rival = next((place for place in others if method_of(place.entry) != method), None)
        ratio = None if rival is None else rival.over(first)
        ratios += [] if ratio is None else [ratio.value]
    basis = plural(max(len(choice.problems) for choice in choices), "problem")
    if not ratios:
        return f"{basis}, no other reaches it there"
    low, high = (_number(edge) for edge in (min(ratios), max(ratios)))
    factor = low if low == high else f"{low} to {high}"
    text = f"{basis}, other kinds of methods cost {factor} times as much where they reach it"
    return f"{text}, on fewer problems" if min(ratios) < 1.0 else text


def _number(factor: float) -> str:
    return f"{factor:,.0f}" if factor >= 10 else f"{factor:.2g}"
