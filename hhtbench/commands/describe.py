"""The command ``hhtbench describe``."""

from __future__ import annotations

import click

from hhtbench.description import describe
from hhtbench.registry import load_problem


@click.command("describe")
@click.argument("problem")
def describe_command(problem: str) -> None:
    """State what PROBLEM declares, what is therefore not computed, and how it is evaluated."""
    click.echo(str(describe(load_problem(problem))))
