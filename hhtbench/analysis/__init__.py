"""Pure functions from rows of the store to tables; no function drops a failed row."""

from hhtbench.analysis.accuracy import convergence, entries, multipliers, work_precision
from hhtbench.analysis.cells import SUBJECT, Point, by_entry, family, number, points, problems, typical
from hhtbench.analysis.drift import drift, drift_series
from hhtbench.analysis.fronts import TARGETS, Comparison, compare, fronts
from hhtbench.analysis.outcomes import counters, failures, machines, statuses

__all__ = [
    "SUBJECT",
    "TARGETS",
    "Comparison",
    "Point",
    "by_entry",
    "compare",
    "convergence",
    "counters",
    "drift",
    "drift_series",
    "entries",
    "failures",
    "family",
    "fronts",
    "machines",
    "multipliers",
    "number",
    "points",
    "problems",
    "statuses",
    "typical",
    "work_precision",
]
