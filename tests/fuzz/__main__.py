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

from hhtbench.runtime.processes import one_blas_thread
from tests.fuzz.explore import Explored, explore, fault_of, read

SHARE = 400  # cases of one process
STILL = 180.0  # s without a new case: the process hangs
WEIGHTS = {"steps": 0.3, "control": 0.2, "machine": 0.1, "hostile": 0.4}  # of all cases


def begun(case: str) -> None:
    """Print which case runs; where it stands still, say what it was at, and end the process."""
    click.echo(case)
    faulthandler.dump_traceback_later(STILL, exit=True)


def watch(family: str, first: int, count: int) -> tuple[str, Explored]:
    """What a process has found; where it dies, the case it was at."""
    command = [sys.executable, "-m", "tests.fuzz", "--share", family, "--seed", str(first), "--cases", str(count)]
    ended = subprocess.run(command, capture_output=True, text=True)
    last = ended.stdout.splitlines()[-1:]
    try:
        found = Explored(**json.loads(*last))
    except (ValueError, TypeError):
        why = f"ends its process ({ended.returncode}): {' | '.join(ended.stderr.splitlines()[-8:])}"
        found = Explored(faults=[(why, *last)])
    faults = [f"\n{fault}\n  python -m tests.fuzz --case {json.dumps(case)}" for fault, case in found.faults]
    click.echo(f"{family}, seed {first}: {found.cases} cases, {len(faults)} faults{''.join(faults)}")
    return family, found


def report(shares: list[tuple[str, Explored]]) -> int:
    """Print what came of the cases; returns the number of faults."""
    table, motion = [], sum((Counter(one.motion) for _, one in shares), Counter())
    for family in WEIGHTS:
        own = [one for name, one in shares if name == family]
        ends = sum((Counter(one.ends) for one in own), Counter()).most_common()
        counts = sum(one.cases for one in own), sum(one.sound for one in own)
        table.append([family, *counts, ", ".join(f"{name} {count}" for name, count in ends)])
    click.echo(tabulate(table, headers=["family", "cases", "must arrive", "ends"]))
    if motion:
        click.echo("\nThe motions of hostile cases that say success are judged by:")
        click.echo(tabulate([[name, count, f"{count / motion.total():.1%}"] for name, count in motion.most_common()]))
    return sum(len(one.faults) for _, one in shares)


@click.command()
@click.option("--cases", "count", type=click.IntRange(min=1), default=10_000, show_default=True)
@click.option("--seed", type=int, help="Of the draws; without it a new one, which is printed.")
@click.option("--jobs", type=click.IntRange(min=1), default=2, show_default=True, help="Processes at once.")
@click.option("--only", multiple=True, type=click.Choice(list(WEIGHTS)), help="Families of cases.")
@click.option("--case", help="One case, as it was printed: what is wrong with it.")
@click.option("--share", "family", hidden=True)
def main(count: int, seed: int | None, jobs: int, only: tuple[str, ...], case: str | None, family: str | None) -> None:
    """Draw cases, solve, judge; exit 1 where one shows a fault."""
    one_blas_thread()
    first, began = secrets.randbelow(10**6) * 10**6 if seed is None else seed, time.perf_counter()
    if family is not None:
        return click.echo(json.dumps(vars(explore(family, first, count, begun=begun))))
    if case is not None:
        found = fault_of(read(case))
        click.echo(found or "nothing is wrong")
        sys.exit(bool(found))
    click.echo(f"--seed {first}")
    weights = {name: weight for name, weight in WEIGHTS.items() if name in only or not only}
    parts = [(name, round(count * weight / sum(weights.values()))) for name, weight in weights.items()]
    parts = [(name, first + done, min(SHARE, some - done)) for name, some in parts for done in range(0, some, SHARE)]
    with ThreadPoolExecutor(jobs) as threads:
        faults = report(list(threads.map(lambda part: watch(*part), sorted(parts, key=lambda part: -part[2]))))
    click.echo(f"\n{count} cases by --seed {first}, {faults} faults, {time.perf_counter() - began:.0f} s")
    sys.exit(faults > 0)


if __name__ == "__main__":
    main()
