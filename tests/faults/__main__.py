"""``python -m tests.faults``: every fault in a copy of the tree; which check finds it, and which faults survive."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import distribution
from pathlib import Path
from queue import Queue

import click
from tabulate import tabulate

from tests.faults.one import SECONDS
from tests.faults.planted import FAULTS, Fault

ROOT = Path(__file__).parents[2]
COPIED = ("hhtbench", "solvers", "problems", "tests")
WANTED = 0.95  # of the faults
PATIENCE = 3600.0  # s, of a machine under load; processor time is limited where the checks run
LONGEST = 110  # characters of a message


def copy_tree(target: Path) -> Path:
    """The sources, as an installed distribution of their own: names of solvers and problems mean those of the copy."""
    for name in COPIED:
        shutil.copytree(ROOT / name, target / name)  # with compiled modules: those of a fault are told by their time
    shutil.copy(ROOT / "pyproject.toml", target)
    installed = distribution("hhtbench")
    about = f"hhtbench-{installed.version}.dist-info"
    without_origin = shutil.ignore_patterns("direct_url.json")  # it names the folder that the copy was made of
    shutil.copytree(str(installed.locate_file(about)), target / about, ignore=without_origin)
    return target


def run_checks(tree: Path, checked: str, first: str = "") -> dict[str, str]:
    """What ``tests.faults.one`` prints there."""
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    command = [sys.executable, "-m", "tests.faults.one", checked, first]
    options = {"cwd": tree, "env": environment, "capture_output": True, "text": True, "timeout": PATIENCE}
    done = subprocess.run(command, check=False, **options)
    if done.returncode == -signal.SIGXCPU:
        return {"flagged": "time", "message": f"the checks did not end in {SECONDS} s of processor time"}
    try:
        found = json.loads(done.stdout.splitlines()[-1])
    except (ValueError, IndexError):
        last = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        return {"flagged": "import", "message": last[-1]}
    if found["unsound"]:
        raise click.ClickException(f"{checked}: {found['unsound']}")
    return found


@dataclass(frozen=True)
class Found:
    """What became of one fault."""

    fault: Fault
    flagged: str  #: the check that found it; "": none did
    message: str  #: what it said
    seconds: float  #: of wall time

    def row(self) -> list[str]:
        """Of the table."""
        fault, flagged = self.fault, self.flagged or "SURVIVES"
        return [fault.name, fault.file, fault.checked, flagged, self.message[:LONGEST], f"{self.seconds:.0f}"]


def find(fault: Fault, trees: Queue[Path]) -> Found:
    """Plant one fault in a copy that is free, check, and take it out again."""
    tree = trees.get()
    before = fault.plant(tree)
    began = time.perf_counter()
    try:
        found = run_checks(tree, fault.checked, fault.first)
    finally:
        (tree / fault.file).write_text(before, encoding="utf-8")
        trees.put(tree)
    result = Found(fault, found["flagged"], found["message"], time.perf_counter() - began)
    click.echo(f"{fault.name}: {result.flagged or 'SURVIVES'} ({result.seconds:.0f} s)", err=True)
    return result


@click.command()
@click.option(
    "--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Copies in which faults are looked for."
)
@click.option("--only", multiple=True, help="Faults whose name or file holds this text; may be given several times.")
@click.option("--sound", is_flag=True, help="First check that without a fault nothing is flagged.")
def main(jobs: int, only: tuple[str, ...], sound: bool) -> None:
    """Plant every fault; exit 1 where fewer than 95 % are found."""
    chosen = [fault for fault in FAULTS if not only or any(text in fault.name or text in fault.file for text in only)]
    if not chosen:
        raise click.BadParameter(f"no fault's name or file holds {' or '.join(only)}", param_hint="--only")
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(jobs) as threads:
        trees: Queue[Path] = Queue()
        for index in range(jobs):
            trees.put(copy_tree(Path(folder).resolve() / str(index)))
        if sound:
            refuse_unsound(trees, chosen, threads)
        found = list(threads.map(lambda fault: find(fault, trees), chosen))
    sys.exit(0 if report(found, time.perf_counter() - began) >= WANTED else 1)


def report(found: list[Found], seconds: float) -> float:
    """Print the table and who survives, with what explains it; the share of the faults that were found."""
    heads = ["fault", "planted in", "checked", "flagged by", "which says", "s"]
    click.echo(tabulate([one.row() for one in found], headers=heads, disable_numparse=True))
    survivors = [one.fault for one in found if not one.flagged]
    share = 1 - len(survivors) / len(found)
    click.echo(f"\n{len(found) - len(survivors)} of {len(found)} faults found ({share:.0%}), {seconds:.0f} s")
    click.echo("survivors: " + ("" if survivors else "none"))
    for fault in survivors:
        click.echo(f"  {fault.name} ({fault.file}): {fault.survives or 'not explained'}")
    return share


def refuse_unsound(trees: Queue[Path], chosen: list[Fault], threads: ThreadPoolExecutor) -> None:
    """End where the checks flag something without any fault: they would find every fault."""

    def look(checks: tuple[str, str]) -> dict[str, str]:
        tree = trees.get()
        try:
            return run_checks(tree, *checks)
        finally:
            trees.put(tree)

    every = sorted({(fault.checked, fault.first if fault.by_tests else "") for fault in chosen})
    unsound = False
    for (checked, _), found in zip(every, threads.map(look, every), strict=True):
        click.echo(f"without a fault, {checked}: {found['flagged'] or 'nothing flagged'} {found['message']}", err=True)
        unsound = unsound or bool(found["flagged"])
    if unsound:
        sys.exit(1)


if __name__ == "__main__":
    main()
