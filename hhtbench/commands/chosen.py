"""The options by which a command is told a campaign: ``run`` makes it, ``status`` says what of it is left."""

from __future__ import annotations

import click

from hhtbench.output import with_options

campaign_options = with_options(  # what hhtbench.campaign.asked.asked_campaign takes
    click.option("--problems", multiple=True, help='Specs, "andrews, knife_edge(Om=3)"; may be given several times.'),
    click.option("--solvers", multiple=True, help='Specs, "hht(alpha=-0.1), ida(form=ggl)".'),
    click.option("--rtol", multiple=True, help='Relative tolerances, "1e-4, 1e-6".'),
    click.option("--step", multiple=True, help="Constant steps [s]."),
    click.option("--steps", multiple=True, help="Numbers of equal steps."),
    click.option("--campaign", "name", help="quick, full or FILE.toml; --problems and --solvers then choose a part of it."),
    click.option("--max-seconds", type=float, help="Most wall-clock time of one solve [s]."),
    click.option(
        "--reference",
        type=click.Choice(["none", "auto"]),
        help="auto: certify problems without a known truth by two families on two forms first.  [default: the campaign's]",
    ),
)
