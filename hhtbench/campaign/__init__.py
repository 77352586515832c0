"""Campaigns: problems x solvers x accuracies, each cell in a worker process, every row in a store."""

from hhtbench.campaign.campaign import Done, run_campaign
from hhtbench.campaign.execute import Limits
from hhtbench.campaign.files import named_campaign, read_campaign
from hhtbench.campaign.plan import Campaign, Cell, Grid, Pair, plan_pairs, restrict

__all__ = [
    "Campaign",
    "Cell",
    "Done",
    "Grid",
    "Limits",
    "Pair",
    "named_campaign",
    "plan_pairs",
    "read_campaign",
    "restrict",
    "run_campaign",
]
