"""The command ``hhtbench study stability``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hhtbench.cli.output import json_option, require_folder, write_json
from hhtbench.runtime.interruption import ends_at_once
from hhtbench.runtime.progress import progress

if TYPE_CHECKING:
    from hhtbench.conformance.entry import Outcome
    from hhtbench.conformance.stability.workers import Batch


@click.command("stability")
@click.option("--only", multiple=True, help="An axis; may be repeated.  [default: all]")
@click.option("--solver", "solvers", multiple=True, help="A spec, your own solver's too; may be repeated.  [default: all]")
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of the random scenes.")
@click.option("--jobs", type=click.IntRange(min=1), default=2, show_default=True, help="Worker processes.")
@click.option("--small", is_flag=True, help="Only the small set that conformance checks of external solvers use.")
@click.option(
    "--report", "folder", type=click.Path(file_okay=False, path_type=Path), help="Write stability.html into this folder."
)
@json_option
def stability_command(
    only: tuple[str, ...],
    solvers: tuple[str, ...],
    seed: int,
    jobs: int,
    small: bool,
    folder: Path | None,
    json_file: Path | None,
) -> None:
    """Measure solvers along every axis of the extremes: arrived rightly, ended early, out of budget, silently wrong.

    A letter a cell, along the parameter: r right, n ended early with a status, b out of budget, m wrong with a message that
    names the cause, W silently wrong, C crashed, H hung, - declined.
    For example: hhtbench study stability --only stiffness --solver hht --solver ida
    """
    with ends_at_once():
        from hhtbench.conformance.stability.page import write_stability
        from hhtbench.conformance.stability.study import study_stability

    require_folder(json_file)
    with progress() as bar:

        def tell(batch: Batch, measured: Sequence[Outcome]) -> None:
            bar.show(_shown(batch, measured))

        found = study_stability(only, solvers, seed=seed, jobs=jobs, small=small, tell=tell, progress=bar.advance)
    click.echo()
    for solver in found.solvers:
        click.echo(found.sentence(solver))
    if folder is not None:
        click.echo(f"written: {write_stability(found, folder)}")
    write_json(found.as_dict(), json_file)


def _shown(batch: Batch, measured: Sequence[Outcome]) -> str:
    """Format the outcomes of one batch as letters, one line per parameter axis."""
    from hhtbench.conformance.stability.study import letters

    seconds = sum(x.seconds for x in measured)
    lines = [f"{batch.family}, {batch.solver} [{seconds:.0f} s]"]
    lines += [f"    {text} {line}" for line, text in letters(measured)[batch.solver].items()]
    return "\n".join(lines)
