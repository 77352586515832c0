"""Campaigns: problems x solvers x accuracies, each cell in a worker process, every row in a store."""

from hhtbench.campaign.campaign import Done, run_campaign
from hhtbench.campaign.execute import Limits
from hhtbench.campaign.files import named_campaign, read_campaign
from hhtbench.campaign.plan import Campaign, Cell, Grid, Pair, plan_cells, plan_pairs, restrict
from hhtbench.campaign.refine import End, next_cells, next_request

__all__ = [
    "Campaign",
    "Cell",
    "Done",
    "End",
    "Grid",
    "Limits",
    "Pair",
    "named_campaign",
    "next_cells",
    "next_request",
    "plan_cells",
    "plan_pairs",
    "read_campaign",
    "restrict",
    "run_campaign",
]
