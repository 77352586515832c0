"""The command ``hhtbench reference``: build, check, show."""

from __future__ import annotations

from pathlib import Path

import click

from hhtbench.cli.output import FILE, FOLDER, Command, Found, judged
from hhtbench.runtime.interruption import ends_at_once
from hhtbench.runtime.progress import progress

SAMPLE = 3  # references that ``check`` computes again unless told otherwise: the first of the plan, which are quick
plan_option = click.option("--plan", "file", type=FILE, help="TOML plan.  [default: the library's]")
stored_option = click.option("--folder", type=FOLDER, help="Stored references.  [default: the library's]")


@click.group("reference")
def reference_command() -> None:
    """Certified reference solutions with error bars.

    For example: hhtbench reference show andrews
    """


@reference_command.command("build", cls=Command)
@click.argument("names", nargs=-1)
@plan_option
@click.option("--out", required=True, type=FOLDER, help="Folder for NAME.json.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Worker processes.")
def build_command(names: tuple[str, ...], file: Path | None, out: Path, jobs: int) -> Found:
    """Compute the references NAMES (all of the plan if none is named) and write them with their error bars.

    For example: hhtbench reference build andrews --out references
    """
    with ends_at_once():
        from hhtbench.campaign.reference.build import build
        from hhtbench.campaign.reference.plan import choose, load_plan, registered_plans

    entries = choose(registered_plans() if file is None else load_plan(file), names)
    with progress() as bar:
        built = build(entries, out, jobs, bar)
    failed = sum(not one["certified"] for one in built)
    text = f"{len(entries) - failed} of {len(entries)} references certified; files in {out}"
    return Found(text, built, failed > 0)


@reference_command.command("check", cls=Command)
@click.argument("names", nargs=-1)
@plan_option
@stored_option
@click.option("--sample", type=click.IntRange(min=1), default=SAMPLE, show_default=True, help="How many, if none is named.")
def check_command(names: tuple[str, ...], file: Path | None, folder: Path | None, sample: int) -> Found:
    """Compute references again, their confirmation included, and compare with the stored ones.

    For example: hhtbench reference check --sample 5
    """
    with ends_at_once():
        from hhtbench.campaign.reference.plan import choose, load_plan, registered_plans
        from hhtbench.campaign.reference.stored import recomputed
        from hhtbench.protocol.evidence import Evidence

    plan = registered_plans() if file is None else load_plan(file)
    entries = choose(plan, names) if names else list(plan.values())[:sample]
    rows = []
    with progress() as bar:
        for count, entry in enumerate(entries):
            bar.advance("references", count, len(entries))
            rows += recomputed(entry, folder)
    return judged(Evidence(title="references", rows=tuple(rows)))


@reference_command.command("show", cls=Command)
@click.argument("name")
@stored_option
def show_command(name: str, folder: Path | None) -> Found:
    """Print what the reference NAME holds: digits, methods and error bars at the stated times.

    For example: hhtbench reference show andrews
    """
    with ends_at_once():
        from hhtbench.campaign.reference.files import read_certificate
        from hhtbench.campaign.reference.stored import folder_of, text_of

    stored = read_certificate(folder_of(folder) / f"{name}.json")
    return Found(text_of(stored), stored)
