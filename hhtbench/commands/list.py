"""The command ``hhtbench list``."""

from __future__ import annotations

import click

from hhtbench import plugins


@click.command("list")
def list_command() -> None:
    """List problems, solvers and verifications."""
    for kind in plugins.GROUPS:
        summaries = plugins.summaries(kind)
        click.echo(f"{kind}s" + ("" if summaries else ": none registered"))
        width = max(map(len, summaries), default=0)
        for name, summary in summaries.items():
            click.echo(f"  {name:{width}}  {summary}".rstrip())
