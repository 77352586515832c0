"""The command ``hhtbench describe``."""

from __future__ import annotations

from pathlib import Path

import click

from hhtbench.interruption import ends_at_once
from hhtbench.output import json_option, write_json


@click.command("describe")
@click.argument("problem")
@json_option
def describe_command(problem: str, json_file: Path | None) -> None:
    """State what PROBLEM declares, what is therefore not computed, and how it is evaluated.

    For example: hhtbench describe "planar_chain(n_links=100)"
    """
    with ends_at_once():
        from hhtbench.description import describe
        from hhtbench.registry import load_problem

    found = describe(load_problem(problem))
    write_json(found.as_dict(), json_file)
    click.echo(str(found))
