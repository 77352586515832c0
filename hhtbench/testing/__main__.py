"""``python -m hhtbench.testing NAME``: every check of a solver, without pytest."""

from __future__ import annotations

import sys
import time
from collections import Counter

import click

from hhtbench import testing
from hhtbench.processes import one_blas_thread


@click.command("hhtbench.testing")
@click.argument("solver")
@click.option("--only", default="", help="Checks whose name holds this text.")
@click.option("--suite", type=click.Choice(["claims", "extremes"]), default="claims", help="Or hostile cases.")
@click.option("--first", is_flag=True, help="Stop at the first that fails.")
def main(solver: str, only: str, suite: str, first: bool) -> None:
    """Run every check of SOLVER, a name or a spec; exit 1 where one fails."""
    one_blas_thread()
    began, kinds = time.perf_counter(), Counter[str]()
    for check in testing.check_solver(solver, suite=suite):
        if only not in check.name:
            continue
        verdict = check.run()
        kinds[verdict.kind.value] += 1
        if verdict.message:
            click.echo(f"{verdict.kind.value:9} {verdict.name}: {verdict.message}")
        if first and not verdict.kind.good:
            break
    told = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
    click.echo(f"{solver}: {told}, in {time.perf_counter() - began:.0f} s")
    sys.exit(1 if kinds["failed"] else 0)


if __name__ == "__main__":
    main()
