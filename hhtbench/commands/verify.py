"""The command ``hhtbench verify``."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import click

from hhtbench.output import conclude, json_option, require_folder, shown
from hhtbench.registry import load_verification
from hhtbench.report import write_report


@click.command("verify")
@click.argument("name")
@json_option
@click.option(
    "--report", "folder", type=click.Path(file_okay=False, path_type=Path), help="Write the report into this folder."
)
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Worker processes.")
def verify_command(name: str, json_file: Path | None, folder: Path | None, jobs: int) -> None:
    """Measure the claims of the verification NAME."""
    require_folder(json_file)
    evidence = load_verification(name)(_progress(), jobs)
    if folder is not None:
        write_report(evidence, folder, f"hhtbench verify {name} --report {shown(folder)}")
    conclude(evidence, json_file)


def _progress() -> Callable[[str], None] | None:
    """Lines on stderr for a person who waits; None where nobody looks."""
    if not sys.stderr.isatty():
        return None
    return lambda text: click.echo(text, err=True)
