"""The command ``hhtbench reference``: build, check, show."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from hhtbench.interruption import ends_at_once
from hhtbench.output import FAILED, conclude, json_option, require_folder, write_json
from hhtbench.progress import progress

SAMPLE = 3  # references that ``check`` computes again unless told otherwise: the first of the plan, which are quick


@click.group("reference")
def reference_command() -> None:
    """Certified reference solutions with error bars.

    For example: hhtbench reference show andrews
    """


plan_option = click.option(
    "--plan", "file", type=click.Path(dir_okay=False, path_type=Path), help="TOML plan.  [default: the library's]"
)


@reference_command.command("build")
@click.argument("names", nargs=-1)
@plan_option
@click.option("--out", required=True, type=click.Path(file_okay=False, path_type=Path), help="Folder for NAME.json.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Worker processes.")
@json_option
def build_command(names: tuple[str, ...], file: Path | None, out: Path, jobs: int, json_file: Path | None) -> None:
    """Compute the references NAMES (all of the plan if none is named) and write them with their error bars.

    For example: hhtbench reference build andrews --out references
    """
    with ends_at_once():
        from hhtbench.reference.build import build
        from hhtbench.reference.plan import choose, load_plan, registered_plans

    require_folder(json_file)
    entries = choose(registered_plans() if file is None else load_plan(file), names)
    with progress() as told:
        built = build(entries, out, jobs, told)
    write_json(built, json_file)
    failed = sum(not one["certified"] for one in built)
    click.echo(f"{len(entries) - failed} of {len(entries)} references certified; files in {out}")
    sys.exit(FAILED if failed else 0)


@reference_command.command("check")
@click.argument("names", nargs=-1)
@plan_option
@click.option(
    "--folder", type=click.Path(file_okay=False, path_type=Path), help="Stored references.  [default: the library's]"
)
@click.option("--sample", type=click.IntRange(min=1), default=SAMPLE, show_default=True, help="How many, if none is named.")
@json_option
def check_command(
    names: tuple[str, ...], file: Path | None, folder: Path | None, sample: int, json_file: Path | None
) -> None:
    """Compute references again, their confirmation included, and compare with the stored ones.

    For example: hhtbench reference check --sample 5
    """
    with ends_at_once():
        from hhtbench.evidence import Evidence
        from hhtbench.reference.plan import choose, load_plan, registered_plans
        from hhtbench.reference.stored import recomputed

    require_folder(json_file)
    plan = registered_plans() if file is None else load_plan(file)
    entries = choose(plan, names) if names else list(plan.values())[:sample]
    rows = []
    with progress() as told:
        for count, entry in enumerate(entries):
            told.advance("references", count, len(entries))
            rows += recomputed(entry, folder)
    conclude(Evidence(title="references", rows=tuple(rows)), json_file)


@reference_command.command("show")
@click.argument("name")
@click.option(
    "--folder", type=click.Path(file_okay=False, path_type=Path), help="Stored references.  [default: the library's]"
)
@json_option
def show_command(name: str, folder: Path | None, json_file: Path | None) -> None:
    """Print what the reference NAME holds: digits, methods and error bars at the stated times.

    For example: hhtbench reference show andrews
    """
    with ends_at_once():
        from hhtbench.reference.files import read_certificate
        from hhtbench.reference.stored import folder_of, text_of

    require_folder(json_file)
    stored = read_certificate(folder_of(folder) / f"{name}.json")
    write_json(stored, json_file)
    click.echo(text_of(stored))
