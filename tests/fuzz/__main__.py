"""``python -m tests.fuzz``: thousands of random mechanisms, solved in every way; which of them show a fault.

Every process has a share of the cases: one that dies, or stands still and is ended, is a fault of the case it was at.
"""

from __future__ import annotations

import faulthandler
import json
import secrets
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import click
from tabulate import tabulate

from hhtbench.processes import one_blas_thread
from tests.fuzz.cases import FAMILIES
from tests.fuzz.explore import explore, fault_of, read, simplest

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


def begun(case: str) -> None:
    """Tell which case runs; where it stands still, what it was at, and end the process."""
    click.echo(case)
    faulthandler.dump_traceback_later(STILL, exit=True)


def share(family: str, first: int, count: int) -> None:
    """What one process does: print every case before it is solved, and at last the result as JSON."""
    found = explore(family, first, count, begun=begun)
    if found.faults:
        found.faults.append(simplest(family, first, count))
    click.echo(json.dumps(vars(found)))


def watch(family: str, first: int, count: int) -> dict:
    """What a process has found; where it dies, the case it was at."""
    command = [sys.executable, "-m", "tests.fuzz", "--share", family, "--seed", str(first), "--cases", str(count)]
    ended = subprocess.run(command, capture_output=True, text=True)
    last = ended.stdout.splitlines()[-1:]
    try:
        found: dict = json.loads(*last)
    except (ValueError, TypeError):
        why = f"ends its process ({ended.returncode}): {' | '.join(ended.stderr.splitlines()[-8:])}"
        found = {"cases": 0, "sound": 0, "ends": {}, "faults": [(why, *last)]}
    told = [f"\n{fault}\n  python -m tests.fuzz --case {json.dumps(case)}" for fault, case in found["faults"]]
    click.echo(f"{family}, seed {first}: {found['cases']} cases, {len(told)} faults{''.join(told)}")
    return {"family": family, **found}


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
@click.option("--share", "family", hidden=True)
def main(count: int, seed: int | None, jobs: int, only: tuple[str, ...], case: str | None, family: str | None) -> None:
    """Draw cases, solve, judge; exit 1 where one shows a fault."""
    one_blas_thread()
    first, began = secrets.randbelow(10**6) * 10**6 if seed is None else seed, time.perf_counter()
    if family is not None:
        return share(family, first, count)
    if case is not None:
        found = fault_of(read(case))
        click.echo(found or "nothing is wrong")
        sys.exit(bool(found))
    click.echo(f"--seed {first}")
    with ThreadPoolExecutor(jobs) as threads:
        parts = [(*part, first + SHARE * i) for i, part in enumerate(shares(count, only))]
        results = list(threads.map(lambda part: watch(part[0], part[2], part[1]), parts))
    sys.exit(report(results, first, time.perf_counter() - began))


if __name__ == "__main__":
    main()
