"""The command ``hhtbench study``."""

from __future__ import annotations

import click

from hhtbench.commands.acceptance import acceptance_command


@click.group("study")
def study_command() -> None:
    """Studies of the bench's own advice, and of solvers at their extremes."""


study_command.add_command(acceptance_command)
