"""The command ``hhtbench reference``: build, check, show."""

from __future__ import annotations

import sys
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any

import click
import numpy as np
from tabulate import tabulate

from hhtbench.errors import ProblemError
from hhtbench.evidence import Evidence, Row
from hhtbench.output import FAILED, conclude, json_option, require_folder, write_json
from hhtbench.processes import worker_processes
from hhtbench.reference.certify import Certificate, certify
from hhtbench.reference.files import read_certificate, write_certificate
from hhtbench.reference.plan import Entry, choose, load_plan, registered_folder, registered_plans

SAMPLE = 3  # references that ``check`` computes again unless told otherwise: the first of the plan, which are quick


@click.group("reference")
def reference_command() -> None:
    """Certified reference solutions with error bars."""


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
    """Compute the references NAMES (all of the plan if none is named) and write them with their error bars."""
    require_folder(json_file)
    entries = choose(registered_plans() if file is None else load_plan(file), names)
    out.mkdir(parents=True, exist_ok=True)
    built: list[dict[str, Any]] = []
    with worker_processes(jobs, max_tasks_per_child=1) as pool:
        waiting = {pool.submit(certify, entry): entry for entry in entries}
        for done in as_completed(waiting):
            entry, error = waiting[done], done.exception()
            if error is not None:
                text = f"{type(error).__name__}: {error}"
                built.append({"name": entry.name, "certified": False, "error": text})
                click.echo(f"{entry.name}: {text}", err=True)
                continue
            certificate = done.result()
            digits = {name: certificate.digits(name) for name in certificate.values}
            stored = str(write_certificate(certificate, out))
            built.append({"name": entry.name, "certified": certificate.certified, "digits": digits, "file": stored})
            click.echo(_line(certificate))
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
    """Compute references again, their confirmation included, and compare with the stored ones."""
    require_folder(json_file)
    plan = registered_plans() if file is None else load_plan(file)
    entries = choose(plan, names) if names else list(plan.values())[:sample]
    evidence = Evidence(title="references", rows=tuple(row for entry in entries for row in _recomputed(entry, folder)))
    conclude(evidence, json_file)


@reference_command.command("show")
@click.argument("name")
@click.option(
    "--folder", type=click.Path(file_okay=False, path_type=Path), help="Stored references.  [default: the library's]"
)
@json_option
def show_command(name: str, folder: Path | None, json_file: Path | None) -> None:
    """Print what the reference NAME holds: digits, methods and error bars at the stated times."""
    require_folder(json_file)
    stored = read_certificate(_folder(folder) / f"{name}.json")
    write_json(stored, json_file)
    click.echo(f"{stored['spec']}: values of {stored['first']} at rtol {stored['rtol']:g}")
    if stored["note"]:
        click.echo(stored["note"])
    heads = ["confirmed by", "form", "status", *(f"difference in {quantity}" for quantity in stored["values"])]
    rows = [
        [other["solver"], other["form"], other["status"], *(other["largest_difference"].get(q) for q in stored["values"])]
        for other in stored["confirmed_by"]
    ]
    click.echo("\n" + tabulate(rows, headers=heads, floatfmt=".1e"))
    stated = [int(np.argmin(np.abs(stored["t"] - t))) for t in stored["stated"]]
    bars = [[stored["t"][i], *(stored["bars"][quantity][i] for quantity in stored["bars"])] for i in stated]
    click.echo("\nscaled error bars at the stated times")
    click.echo(tabulate(bars, headers=["t [s]", *stored["bars"]], floatfmt=["g", *[".1e"] * len(stored["bars"])]))


def _recomputed(entry: Entry, folder: Path | None) -> list[Row]:
    """One row a quantity: the new disagreement against the stored bar."""
    stored = read_certificate(_folder(folder) / f"{entry.name}.json")
    again = certify(entry)
    if not np.array_equal(stored["t"], again.t):
        raise ProblemError(f"{entry.name}: the stored times are not those of the plan; build it again.")
    rows = []
    for name, values in stored["values"].items():
        size = np.max(np.abs(again.values[name] - values) / stored["scales"][name], axis=1)
        bar = stored["bars"][name] + again.bars[name]
        worst = int(np.argmax(size / bar))
        claim = f"{entry.name}: {name} computed again lies within the error bars"
        text = f"{bar[worst]:.1e} at t = {again.t[worst]:g} s"
        rows.append(
            Row(
                id=f"{entry.name}/{name}",
                claim=claim,
                measured=size[worst],
                bound=text,
                passed=bool(np.all(size <= bar) and np.all(np.isfinite(bar))),
            )
        )
    return rows


def _folder(folder: Path | None) -> Path:
    if folder is not None and not folder.is_dir():
        raise ProblemError(f"there is no folder {folder} with references; build some with `hhtbench reference build`.")
    return registered_folder() if folder is None else folder


def _line(certificate: Certificate) -> str:
    digits: dict[str, Any] = {name: f"{certificate.digits(name):.1f}" for name in certificate.values}
    text = ", ".join(f"{name} {count}" for name, count in digits.items())
    ended = "; ".join(f"{other.solver} {other.status} in {other.seconds:.1f} s" for other in certificate.confirmations)
    verdict = "" if certificate.certified else "NOT CERTIFIED: no independent solver confirms it. "
    return f"{certificate.entry.name}: {verdict}digits: {text} ({ended})"
