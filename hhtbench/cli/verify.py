"""The command ``hhtbench verify``."""

from __future__ import annotations

from pathlib import Path

import click

from hhtbench.cli.output import FOLDER, Command, Found, judged, shown
from hhtbench.runtime.interruption import ends_at_once
from hhtbench.runtime.progress import progress


@click.command("verify", cls=Command)
@click.argument("name")
@click.option("--report", "folder", type=FOLDER, help="Write the report into this folder.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Worker processes.")
def verify_command(name: str, folder: Path | None, jobs: int) -> Found:
    """Measure the claims of the verification NAME.

    For example: hhtbench verify paper --jobs 2 --report reports/latest
    """
    with ends_at_once():
        from hhtbench.catalogue.registry import load_verification
        from hhtbench.report import write_report

    with progress() as bar:
        evidence = load_verification(name)(bar.advance, jobs)
    if folder is not None:
        write_report(evidence, folder, f"hhtbench verify {name} --report {shown(folder)}")
    return judged(evidence)
