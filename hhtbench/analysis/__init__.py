"""Pure functions from rows of the store to tables; no function drops a failed row."""

from hhtbench.analysis.accuracy import Slope, convergence, entries, multipliers, work_precision
from hhtbench.analysis.cells import (
    DOUBTED,
    NEAR,
    SUBJECT,
    TYPICAL_ERROR,
    Point,
    by_entry,
    family,
    number,
    points,
    problems,
    typical,
)
from hhtbench.analysis.drift import (
    drift,
    drift_series,
    equally_accurate,
    invariant_names,
    invariant_series,
    multiplier_series,
)
from hhtbench.analysis.fronts import HELD, HELD_TARGETS, TARGETS, Comparison, Cost, compare, constrained_levels, fronts
from hhtbench.analysis.missing import Missing
from hhtbench.analysis.newest import Newest, newest
from hhtbench.analysis.outcomes import counters, failures, machines, silent, statuses
from hhtbench.analysis.race import RACE_TARGETS, STEADY, Race, race

__all__ = [
    "DOUBTED",
    "HELD",
    "HELD_TARGETS",
    "NEAR",
    "RACE_TARGETS",
    "STEADY",
    "SUBJECT",
    "TARGETS",
    "TYPICAL_ERROR",
    "Comparison",
    "Cost",
    "Missing",
    "Newest",
    "Point",
    "Race",
    "Slope",
    "by_entry",
    "compare",
    "constrained_levels",
    "convergence",
    "counters",
    "drift",
    "drift_series",
    "entries",
    "equally_accurate",
    "failures",
    "family",
    "fronts",
    "invariant_names",
    "invariant_series",
    "machines",
    "multiplier_series",
    "multipliers",
    "newest",
    "number",
    "points",
    "problems",
    "race",
    "silent",
    "statuses",
    "typical",
    "work_precision",
]
