"""The command ``hhtbench describe``."""

from __future__ import annotations

import click

from hhtbench.interruption import ends_at_once
from hhtbench.output import Command, Found


@click.command("describe", cls=Command)
@click.argument("problem")
def describe_command(problem: str) -> Found:
    """State what PROBLEM declares, what is therefore not computed, and how it is evaluated.

    For example: hhtbench describe "planar_chain(n_links=100)"
    """
    with ends_at_once():
        from hhtbench.description import describe
        from hhtbench.registry import load_problem

    found = describe(load_problem(problem))
    return Found(found, found.as_dict())
