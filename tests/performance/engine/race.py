"""At equal error: HHT, the fastest solver that holds the constraints, the fastest at all, the fastest explicit one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from hhtbench.analysis.cells import SUBJECT, family
from hhtbench.analysis.fronts import Cost, fronts
from hhtbench.analysis.missing import Missing
from hhtbench.store.rows import RunRow

RACE_TARGETS = (1e-2, 1e-3, 1e-4)  # achieved scaled errors
STEADY = 1e-10  # drift, scaled, of both levels up to which a run holds the constraints
EXPLICIT = ("scipy(method=DOP853)", "scipy(method='DOP853')")  # high order, on the underlying ODE, never projected


@dataclass(frozen=True, kw_only=True)
class Race:
    """One problem at one error; None where nobody gets there, for the reason in ``missing``."""

    problem: str
    target: float
    subject: Cost | None  #: HHT's cheapest
    steady: bool  #: it is a run of HHT that holds both levels
    holder: Cost | None  #: the cheapest other solver that holds both levels
    other: Cost | None  #: the cheapest other solver at all
    explicit: Cost | None  #: the cheapest explicit method of high order on the underlying ODE
    missing: Mapping[str, Missing]  #: solver -> why it has no cost at this error, whatever its drift
    drifting: Mapping[str, Missing]  #: solver -> why it has none among those that hold both levels

    def factor(self, rival: Cost | None) -> float | None:
        """The rival's time over HHT's: above 1 HHT is faster."""
        return None if self.subject is None or rival is None else rival.value / self.subject.value

    @property
    def best_holder(self) -> bool | None:
        """Whether HHT is the fastest of those that hold both levels; None where that was not measured."""
        if self.subject is None or not self.steady:
            return False if self.holder is not None else None
        return self.holder is None or self.holder.value >= self.subject.value

    @property
    def explicit_is_faster(self) -> bool:
        """Whether an explicit method on the underlying ODE beats HHT, or gets there alone."""
        if self.explicit is None:
            return False
        return self.subject is None or self.explicit.value < self.subject.value


def race(
    rows: Sequence[RunRow], targets: Sequence[float] = RACE_TARGETS, held: float = STEADY, subject: str = SUBJECT
) -> tuple[Race, ...]:
    """One line for each problem and target, in the order of the rows."""
    result = []
    every, steady = (fronts(rows, "time", targets, bound) for bound in (None, held))
    for free, bound in zip(every, steady, strict=True):
        own = _first(bound.costs, lambda cost: family(cost.entry) == subject)
        result.append(
            Race(
                problem=free.problem,
                target=free.target,
                subject=own or _first(free.costs, lambda cost: family(cost.entry) == subject),
                steady=own is not None,
                holder=_first(bound.costs, lambda cost: family(cost.entry) != subject),
                other=_first(free.costs, lambda cost: family(cost.entry) != subject),
                explicit=_first(free.costs, lambda cost: cost.entry in EXPLICIT),
                missing=free.missing,
                drifting=bound.missing,
            )
        )
    return tuple(result)


def _first(costs: Sequence[Cost], wanted: Callable[[Cost], bool]) -> Cost | None:
    return next((cost for cost in costs if wanted(cost)), None)
