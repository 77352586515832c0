"""Command line ``python -m hhtbench.conformance NAME``: run every check of a solver, without pytest."""

from __future__ import annotations

import sys
import time
from collections import Counter

import click

from hhtbench.conformance.check import SUITES, check_solver
from hhtbench.conformance.entry import Kind
from hhtbench.runtime.processes import one_blas_thread


@click.command("hhtbench.conformance")
@click.argument("solver")
@click.option("--only", default="", help="Checks whose name holds this text.")
@click.option("--suite", type=click.Choice(list(SUITES)), default="claims", help="Or hostile cases.")
@click.option("--first", is_flag=True, help="Stop at the first that fails.")
def main(solver: str, only: str, suite: str, first: bool) -> None:
    """Run every check of SOLVER, a name or a spec; exit 1 where one fails."""
    one_blas_thread()
    began, kinds = time.perf_counter(), Counter[Kind]()
    for check in check_solver(solver, suite=suite):
        if only not in check.name:
            continue
        found = check.run()
        kinds[found.kind] += 1
        if found.message and found.kind is not Kind.right:
            click.echo(f"{found.kind.label:9} {found.id}: {found.message}")
        if first and not found.kind.good:
            break
    counts = ", ".join(f"{count} {kind.label}" for kind, count in kinds.items())
    click.echo(f"{solver}: {counts}, in {time.perf_counter() - began:.0f} s")
    sys.exit(0 if all(kind.good for kind in kinds) else 1)


if __name__ == "__main__":
    main()
