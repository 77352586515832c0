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
    """The sources."""
    for name in COPIED:
        shutil.copytree(ROOT / name, target / name)  # with compiled modules: those of a fault are told by their time
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
        return json.loads(done.stdout.splitlines()[-1])
    except (ValueError, IndexError):
        last = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        return {"flagged": "import", "message": last[-1]}


def find(fault: Fault, trees: Queue[Path]) -> dict[str, str]:
    """Plant one fault in a copy that is free, check, and take it out again."""
    tree = trees.get()
    before = fault.plant(tree)
    try:
        found = run_checks(tree, fault.checked, fault.first)
        click.echo(f"{fault.name}: {found['flagged'] or 'SURVIVES'}", err=True)
        return found
    finally:
        (tree / fault.file).write_text(before, encoding="utf-8")
        trees.put(tree)


@click.command()
@click.option(
    "--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Copies in which faults are looked for."
)
@click.option("--only", default="", help="Faults whose name or file holds this text.")
@click.option("--sound", is_flag=True, help="First check that without a fault nothing is flagged.")
def main(jobs: int, only: str, sound: bool) -> None:
    """Plant every fault; exit 1 where fewer than 95 % are found."""
    chosen = [fault for fault in FAULTS if only in fault.name or only in fault.file]
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(jobs) as threads:
        trees: Queue[Path] = Queue()
        for index in range(jobs):
            trees.put(copy_tree(Path(folder).resolve() / str(index)))
        if sound:
            refuse_unsound(trees, sorted({fault.checked for fault in chosen}))
        rows, survivors = [], []
        for fault, found in zip(chosen, threads.map(lambda fault: find(fault, trees), chosen), strict=True):
            flagged = found["flagged"] or "SURVIVES"
            rows.append([fault.name, fault.file, fault.checked, flagged, found["message"][:LONGEST]])
            survivors += [] if found["flagged"] else [fault.name]
    click.echo(tabulate(rows, headers=["fault", "planted in", "checked", "flagged by", "which says"], disable_numparse=True))
    share = 1 - len(survivors) / len(chosen)
    click.echo(
        f"\n{len(chosen) - len(survivors)} of {len(chosen)} faults found ({share:.0%}), {time.perf_counter() - began:.0f} s"
    )
    click.echo("survivors: " + (", ".join(survivors) or "none"))
    sys.exit(0 if share >= WANTED else 1)


def refuse_unsound(trees: Queue[Path], every: list[str]) -> None:
    """End where the checks flag something without any fault: they would find every fault."""
    tree = trees.get()
    for checked in every:
        found = run_checks(tree, checked)
        click.echo(f"without a fault, {checked}: {found['flagged'] or 'nothing flagged'} {found['message']}", err=True)
        if found["flagged"]:
            sys.exit(1)
    trees.put(tree)


if __name__ == "__main__":
    main()
