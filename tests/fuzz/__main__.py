"""``python -m tests.fuzz``: thousands of random mechanisms, solved in every way; which of them show a fault.

Every process has a share of the cases and is watched: one that dies or does not end is a fault of the case it was at.
"""

from __future__ import annotations

import json
import secrets
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import click
from tabulate import tabulate

from hhtbench.processes import one_blas_thread
from tests.fuzz.cases import FAMILIES
from tests.fuzz.explore import explore, faults_of, read, simplest

SHARE = 400  # cases of one process
STILL = 180.0  # s without a new case: the process hangs
WEIGHTS = {"steps": 3, "control": 2, "machine": 1, "hostile": 4}


def shares(count: int, only: tuple[str, ...]) -> list[tuple[str, int]]:
    """Families with numbers of cases, those of one family apart."""
    weights = {name: weight for name, weight in WEIGHTS.items() if name in only or not only}
    found = []
    for name, weight in weights.items():
        left = round(count * weight / sum(weights.values()))
        found += [(name, min(SHARE, left - done)) for done in range(0, left, SHARE)]
    return sorted(found, key=lambda share: -share[1])


def watch(family: str, seed: int, count: int) -> dict:
    """What one process has found; where it dies or stands still, the case it was at."""
    with tempfile.TemporaryDirectory() as folder:
        journal, answer = Path(folder) / "case", Path(folder) / "answer"
        journal.touch()
        command = [sys.executable, "-m", "tests.fuzz", "--share", f"{family}:{seed}:{count}:{folder}"]
        with answer.open("w") as out:
            process = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT)
            while process.poll() is None:
                time.sleep(0.5)
                if time.time() - journal.stat().st_mtime > STILL:
                    process.kill()
                    process.wait()
        lines, at = answer.read_text(encoding="utf-8").splitlines(), journal.read_text(encoding="utf-8")
    try:
        found: dict = json.loads(lines[-1])
    except (ValueError, IndexError):
        last = " | ".join(lines[-5:])
        found = {"cases": 0, "sound": 0, "ends": {}, "faults": [(f"ends its process ({process.returncode}): {last}", at)]}
    told = [f"\n{fault}\n  python -m tests.fuzz --case {json.dumps(case)}" for fault, case in found["faults"]]
    click.echo(f"{family}, seed {seed}: {found['cases']} cases, {len(told)} faults{''.join(told)}")
    return {"family": family, **found}


def share(given: str) -> None:
    """What :func:`watch` has started: print the result as JSON."""
    family, first, count, folder = given.split(":")
    journal = Path(folder) / "case"
    found = explore(family, int(first), int(count), journal=journal)
    if found.faults:
        least = simplest(family, int(first), int(count), journal=journal)
        found.faults += [(f"{least[0]} (the simplest)", least[1])] if least[0] else []
    click.echo(json.dumps(vars(found)))


def report(found: list[dict], seed: int, seconds: float) -> bool:
    """Print what came of the cases; whether there is a fault."""
    table = []
    for family in FAMILIES:
        own = [one for one in found if one["family"] == family]
        ends = sum((Counter(one["ends"]) for one in own), Counter())
        told = ", ".join(f"{name} {count}" for name, count in ends.most_common())
        table.append([family, sum(one["cases"] for one in own), sum(one["sound"] for one in own), told])
    click.echo(tabulate(table, headers=["family", "cases", "must arrive", "ends"]))
    faults = sum(len(one["faults"]) for one in found)
    click.echo(f"\n{sum(row[1] for row in table)} cases by --seed {seed}, {faults} faults, {seconds:.0f} s")
    return faults > 0


@click.command()
@click.option("--cases", "count", type=click.IntRange(min=1), default=10_000, show_default=True)
@click.option("--seed", type=int, help="Of the draws; without it a new one, which is printed.")
@click.option("--jobs", type=click.IntRange(min=1), default=2, show_default=True, help="Processes at once.")
@click.option("--only", multiple=True, type=click.Choice(FAMILIES), help="Families of cases.")
@click.option("--case", help="One case, as it was printed: what is wrong with it.")
@click.option("--share", "given", hidden=True)
def main(count: int, seed: int | None, jobs: int, only: tuple[str, ...], case: str | None, given: str | None) -> None:
    """Draw cases, solve, judge; exit 1 where one shows a fault."""
    one_blas_thread()
    if given is not None:
        return share(given)
    if case is not None:
        found = faults_of(read(case))
        click.echo("\n".join(found) or "nothing is wrong")
        sys.exit(bool(found))
    first, began = secrets.randbelow(10**6) * 1000 if seed is None else seed, time.perf_counter()
    click.echo(f"--seed {first}")
    with ThreadPoolExecutor(jobs) as threads:
        parts = list(enumerate(shares(count, only)))
        results = list(threads.map(lambda part: watch(part[1][0], first + part[0], part[1][1]), parts))
    sys.exit(report(results, first, time.perf_counter() - began))


if __name__ == "__main__":
    main()
