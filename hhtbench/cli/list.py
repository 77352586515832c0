"""The command ``hhtbench list``."""

from __future__ import annotations

import click

from hhtbench.catalogue import plugins
from hhtbench.cli.output import Command, Found

KINDS = ("problem", "solver", "verification", "reference")


@click.command("list", cls=Command)
def list_command() -> Found:
    """List problems, solvers and verifications.

    For example: hhtbench list --json names.json
    """
    found = {kind: plugins.summaries(kind) for kind in KINDS}
    lines = []
    for kind, summaries in found.items():
        lines.append(f"{kind}s" + ("" if summaries else ": none registered"))
        width = max(map(len, summaries), default=0)
        lines += [f"  {name:{width}}  {summary}".rstrip() for name, summary in summaries.items()]
    return Found("\n".join(lines), found)
