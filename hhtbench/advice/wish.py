"""What somebody wants of a solver: errors, a bound of the drift, and what shall be cheap."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from hhtbench.analysis.fronts import MEASURES
from hhtbench.arguments import real_number
from hhtbench.errors import ProblemError

RANGE = re.compile(r"(?P<first>[^.]+(?:\.\d+)?[^.]*)\.\.(?!\.)(?P<last>.+)$")  # three dots are a slip, no .1e-6
DECADE = 10.0


@dataclass(frozen=True, kw_only=True)
class Wish:
    """Checked when it is made.

    Raises
    ------
    ProblemError, TypeError
        A value is out of its range or no number.
    """

    accuracies: tuple[float, ...]  #: scaled errors of q and v, the loosest first
    on: str = "time"  #: what shall be little: "time" (of a processor) or "evaluations"
    drift: float | None = None  #: most scaled drift of the position and velocity level; None: any

    def __post_init__(self) -> None:
        values = tuple(real_number("accuracy", value) for value in self.accuracies)
        if not values or not all(0.0 < value < 1.0 for value in values):
            raise ProblemError(f"accuracy must be errors between 0 and 1, as 1e-4 or 1e-2..1e-6; got {_shown(values)}.")
        object.__setattr__(self, "accuracies", tuple(sorted(set(values), reverse=True)))
        if self.on not in MEASURES:
            raise ProblemError(f"on must be {' or '.join(MEASURES)}; got {self.on!r}.")
        if self.drift is not None and real_number("drift", self.drift) <= 0.0:
            raise ProblemError(f"drift must be above 0, 1e-10 for example, or left out; got {self.drift:g}.")


def listed(accuracies: object) -> tuple[float, ...]:
    """Errors that somebody gives as a list.

    Raises
    ------
    ProblemError
        They are one number or a text.
    """
    if isinstance(accuracies, str) or not isinstance(accuracies, Iterable):
        raise ProblemError(f"accuracies must be a list of errors, as [1e-2, 1e-4]; got {accuracies!r}.")
    return tuple(accuracies)


def accuracies_of(text: str) -> tuple[float, ...]:
    """``1e-2..1e-6`` (by decades, both ends included), ``1e-4`` or ``1e-3, 1e-5``.

    Raises
    ------
    ProblemError
        The text is none of them.
    """
    found = RANGE.match(text.strip())
    try:
        if found is None:
            return tuple(float(word) for word in re.split(r"[,\s]+", text.strip()))
        ends = sorted((float(found["first"]), float(found["last"])), reverse=True)
        decades = math.floor(math.log10(ends[0] / ends[1]) + 1e-9)
    except (ValueError, ArithmeticError) as error:
        raise ProblemError(f"--accuracy takes errors, as 1e-4, 1e-3,1e-5 or 1e-2..1e-6; got {text!r}.") from error
    steps = [float(f"{ends[0] / DECADE**k:.6g}") for k in range(decades + 1)]
    return tuple(dict.fromkeys([*steps, ends[1]]))


def _shown(values: Sequence[float]) -> str:
    return ", ".join(f"{value:g}" for value in values) or "none"
