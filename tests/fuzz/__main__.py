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

from hhtbench.runtime.processes import one_blas_thread
from tests.fuzz.explore import Verdict, explore

SHARE = 400  # cases of one process
STILL = 180.0  # s without a new case: the process hangs
WEIGHTS = {"steps": 0.3, "control": 0.2, "machine": 0.1, "hostile": 0.4}  # of all cases


def share(family: str, first: int, count: int) -> None:
    """Print a line of JSON for each case; where one stands still, end the process with its traceback."""
    faulthandler.dump_traceback_later(STILL, exit=True)
    for found in explore(family, first, count):
        faulthandler.dump_traceback_later(STILL, exit=True)
        click.echo(json.dumps(found))


def watch(family: str, first: int, count: int) -> tuple[str, list[Verdict]]:
    """What a process has found; where it dies, the case it was at has the fault."""
    command = [sys.executable, "-m", "tests.fuzz", "--share", "--only", family, "--seed", str(first), "--cases", str(count)]
    ended = subprocess.run(command, capture_output=True, text=True)
    found = [Verdict(*json.loads(line)) for line in ended.stdout.splitlines()]
    if len(found) < count:
        why = f"ends its process ({ended.returncode}): {' | '.join(ended.stderr.splitlines()[-8:])}"
        found.append(Verdict(first + len(found), "no status", False, why))
    for one in found:
        if one.fault:
            click.echo(f"{one.status}: {one.fault}\n  python -m tests.fuzz --only {family} --cases 1 --seed {one.seed}")
    return family, found


@click.command()
@click.option("--cases", "count", type=click.IntRange(min=1), default=10_000, show_default=True)
@click.option("--seed", type=int, help="Of the first case; without it a new one, which is printed.")
@click.option("--jobs", type=click.IntRange(min=1), default=2, show_default=True, help="Processes at once.")
@click.option("--only", multiple=True, type=click.Choice(list(WEIGHTS)), help="Families of cases.")
@click.option("--share", "shared", is_flag=True, hidden=True)
def main(count: int, seed: int | None, jobs: int, only: tuple[str, ...], shared: bool) -> None:
    """Draw cases, solve, judge; exit 1 where one shows a fault."""
    one_blas_thread()
    first, began = secrets.randbelow(10**6) * 10**6 if seed is None else seed, time.perf_counter()
    if shared:
        return share(only[0], first, count)
    click.echo(f"--seed {first}")
    weights = {name: weight for name, weight in WEIGHTS.items() if name in only or not only}
    parts = [(name, round(count * weight / sum(weights.values()))) for name, weight in weights.items()]
    parts = [(name, first + done, min(SHARE, some - done)) for name, some in parts for done in range(0, some, SHARE)]
    with ThreadPoolExecutor(jobs) as threads:
        shares = list(threads.map(lambda part: watch(*part), sorted(parts, key=lambda part: -part[2])))
    for family in weights:
        own = [one for name, found in shares if name == family for one in found]
        ends = ", ".join(f"{name} {number}" for name, number in Counter(one.status for one in own).most_common())
        click.echo(f"{family}: {len(own)} cases, {sum(one.must_succeed for one in own)} must arrive; {ends}")
    faults = sum(bool(one.fault) for _, found in shares for one in found)
    click.echo(f"{count} cases by --seed {first}, {faults} faults, {time.perf_counter() - began:.0f} s")
    sys.exit(faults > 0)


if __name__ == "__main__":
    main()
