"""Criteria for choosing a solver: errors, a bound on the drift, and what to minimise."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from hhtbench.campaign.analysis.fronts import MEASURES
from hhtbench.protocol.arguments import real_number
from hhtbench.protocol.errors import ProblemError


@dataclass(frozen=True, kw_only=True)
class Criteria:
    """Target errors, drift bound and cost measure; checked when made (``ProblemError`` or ``TypeError``)."""

    accuracies: Sequence[float]  #: scaled errors of q and v, the loosest first
    on: str = "time"  #: what to minimise: "time" (of a processor) or "evaluations"
    drift: float | None = None  #: largest scaled drift of the position and velocity level; None: any

    def __post_init__(self) -> None:
        if isinstance(self.accuracies, str) or not isinstance(self.accuracies, Iterable):
            raise ProblemError(f"accuracies must be a list of errors, as [1e-2, 1e-4]; got {self.accuracies!r}.")
        values = tuple(real_number("accuracy", value) for value in self.accuracies)
        if not values or not all(0.0 < value < 1.0 for value in values):
            shown = ", ".join(f"{value:g}" for value in values) or "none"
            raise ProblemError(f"accuracy must be errors between 0 and 1, as 1e-4 or 1e-2..1e-6; got {shown}.")
        object.__setattr__(self, "accuracies", tuple(sorted(set(values), reverse=True)))
        if self.on not in MEASURES:
            raise ProblemError(f"on must be {' or '.join(MEASURES)}; got {self.on!r}.")
        if self.drift is not None and real_number("drift", self.drift) <= 0.0:
            raise ProblemError(f"drift must be above 0, 1e-10 for example, or left out; got {self.drift:g}.")


def accuracies_of(text: str) -> tuple[float, ...]:
    """Parse errors: ``1e-2..1e-6`` (by decades, both ends included), ``1e-4`` or ``1e-3, 1e-5``; else a ``ProblemError``."""
    first, dots, last = text.partition("..")
    try:
        if not dots:
            return tuple(float(word) for word in text.replace(",", " ").split() or [text])
        if last.startswith("."):
            raise ValueError("three dots")
        high, low = sorted((float(first), float(last)), reverse=True)
        decades = math.floor(math.log10(high / low) + 1e-9)
    except (ValueError, ArithmeticError) as error:
        raise ProblemError(f"--accuracy takes errors, as 1e-4, 1e-3,1e-5 or 1e-2..1e-6; got {text!r}.") from error
    return tuple(dict.fromkeys([*(float(f"{high / 10.0**k:.6g}") for k in range(decades + 1)), low]))
