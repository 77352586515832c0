"""Campaigns: problems x solvers x tolerances or steps, each cell in a worker process, every row in a store."""

from hhtbench.campaign.campaign import Done, run_campaign
from hhtbench.campaign.execute import Limits
from hhtbench.campaign.plan import Campaign, Cell, Grid, named_campaign, plan_cells, read_campaign, restrict

__all__ = [
    "Campaign",
    "Cell",
    "Done",
    "Grid",
    "Limits",
    "named_campaign",
    "plan_cells",
    "read_campaign",
    "restrict",
    "run_campaign",
]
