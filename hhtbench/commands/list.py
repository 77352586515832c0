"""The command ``hhtbench list``."""

from __future__ import annotations

from pathlib import Path

import click

from hhtbench import plugins
from hhtbench.output import json_option, write_json

KINDS = ("problem", "solver", "verification", "reference")


@click.command("list")
@json_option
def list_command(json_file: Path | None) -> None:
    """List problems, solvers and verifications.

    For example: hhtbench list --json names.json
    """
    found = {kind: plugins.summaries(kind) for kind in KINDS}
    write_json(found, json_file)
    for kind, summaries in found.items():
        click.echo(f"{kind}s" + ("" if summaries else ": none registered"))
        width = max(map(len, summaries), default=0)
        for name, summary in summaries.items():
            click.echo(f"  {name:{width}}  {summary}".rstrip())
