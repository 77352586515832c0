"""Pure functions from the rows of a store to tables; no function drops a failed row."""

from hhtbench.campaign.analysis.accuracy import convergence
from hhtbench.campaign.analysis.cells import by_problem, entries, points, problems
from hhtbench.campaign.analysis.decision import decide
from hhtbench.campaign.analysis.drift import drift_costs, drift_series
from hhtbench.campaign.analysis.fronts import compare, fronts
from hhtbench.campaign.analysis.kinds import kinds
from hhtbench.campaign.analysis.outcomes import failures, newest, silent, statuses
from hhtbench.campaign.analysis.profile import profiles, reaches

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
