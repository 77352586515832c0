"""Pure functions from rows of the store to tables; no function drops a failed row."""

from hhtbench.analysis.accuracy import convergence
from hhtbench.analysis.cells import by_problem, entries, points, problems
from hhtbench.analysis.decision import decide
from hhtbench.analysis.drift import drift_costs, drift_series
from hhtbench.analysis.fronts import compare, fronts
from hhtbench.analysis.kinds import kinds
from hhtbench.analysis.outcomes import failures, newest, silent, statuses
from hhtbench.analysis.profile import profiles, reaches

__all__ = [
    "by_problem",
    "compare",
    "convergence",
    "decide",
    "drift_costs",
    "drift_series",
    "entries",
    "failures",
    "fronts",
    "kinds",
    "newest",
    "points",
    "problems",
    "profiles",
    "reaches",
    "silent",
    "statuses",
]
