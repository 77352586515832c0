"""The command ``hhtbench describe``."""

from __future__ import annotations

import click

from hhtbench.cli.output import Command, Found
from hhtbench.runtime.interruption import ends_at_once


@click.command("describe", cls=Command)
@click.argument("problem")
def describe_command(problem: str) -> Found:
    """Show what PROBLEM declares, what is therefore not computed, and how its functions are evaluated.

    For example: hhtbench describe "planar_chain(n_links=100)"
    """
    with ends_at_once():
        from hhtbench.catalogue.registry import load_problem
        from hhtbench.lowering.description import describe

    found = describe(load_problem(problem))
    return Found(found, found.as_dict())
