"""Numbers and short phrases of the comparison, the same on both pages."""

from __future__ import annotations

from hhtbench.analysis import Comparison

MEASURES = {"time": "wall time", "evaluations": "residual evaluations"}
NOTHING = "\N{EN DASH}"


def shown(value: float | None) -> str:
    """Three digits; a dash where nothing was measured."""
    return NOTHING if value is None else f"{value:.3g}"


def count(value: float | None) -> str:
    """A whole number."""
    return NOTHING if value is None else f"{value:.0f}"


def seconds(value: float | None) -> str:
    """A time in the unit that suits its size."""
    if value is None:
        return NOTHING
    for factor, unit in ((1.0, "s"), (1e3, "ms")):
        if value * factor >= 1:
            return f"{value * factor:.3g} {unit}"
    return f"{value * 1e6:.3g} \N{MICRO SIGN}s"


def work(value: float | None, measure: str) -> str:
    """A cost with its unit."""
    return seconds(value) if measure == "time" else count(value)


def times(factor: float) -> str:
    """A factor as a reader would say it."""
    return f"{factor:.3g}\N{MULTIPLICATION SIGN}"


def plural(number: int, word: str) -> str:
    """``1 run``, ``2 runs``."""
    return f"{number} {word}{'' if number == 1 else 's'}"


def listed(parts: list[str]) -> str:
    """``a, b and c``."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def dearer(line: Comparison) -> float:
    """The factor between the two, above 1, whoever wins; 1 where there is none."""
    factor = line.factor or 1.0
    return max(factor, 1.0 / factor)


def factor(line: Comparison) -> str:
    """:func:`dearer` in words: "at most" where the dearer side's cost is an upper bound, "at least" where the other's is."""
    if line.subject is None or line.rival is None:
        return NOTHING
    winner, loser = (line.subject, line.rival) if (line.factor or 0) > 1 else (line.rival, line.subject)
    sign = {(True, False): "at least ", (False, True): "at most ", (True, True): "about "}.get(
        (winner.bound, loser.bound), ""
    )
    return sign + times(dearer(line))


def outcome(line: Comparison) -> str:
    """Who needs less, by which factor."""
    texts = {"unknown": NOTHING, "absent": "HHT does not get there", "alone": "only HHT gets there"}
    return texts.get(line.outcome) or f"{line.outcome} {factor(line)}"
