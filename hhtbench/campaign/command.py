"""The command ``hhtbench run``."""

from __future__ import annotations

import re
import sys
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import click

from hhtbench import plugins
from hhtbench.campaign.campaign import Done, Progress, run_campaign
from hhtbench.campaign.execute import machine_limits
from hhtbench.campaign.files import named_campaign
from hhtbench.campaign.plan import Campaign, Grid, restrict
from hhtbench.campaign.references import auto_references
from hhtbench.errors import ProblemError
from hhtbench.registry import load_solver
from hhtbench.specs import parse_spec
from hhtbench.store import Store

MOST_SHOWN = 12  # failures on the terminal; the store holds all


@click.command("run")
@click.option("--problems", multiple=True, help='Specs, "andrews, knife_edge(Om=3)"; may be given several times.')
@click.option("--solvers", multiple=True, help='Specs, "hht(alpha=-0.1), ida(form=ggl)".')
@click.option("--rtol", multiple=True, help='Relative tolerances, "1e-4, 1e-6".')
@click.option("--step", multiple=True, help="Constant steps [s].")
@click.option("--steps", multiple=True, help="Numbers of equal steps.")
@click.option("--campaign", "name", help="A named campaign (quick); --problems and --solvers then choose a part of it.")
@click.option(
    "--store", "file", type=click.Path(dir_okay=False, path_type=Path), required=True, help="SQLite file; resumed."
)
@click.option("--jobs", type=click.IntRange(min=1), help="Worker processes.  [default: one a core]")
@click.option("--max-seconds", type=float, help="Most wall-clock time of one solve [s].")
@click.option(
    "--reference",
    type=click.Choice(["none", "auto"]),
    help="auto: certify problems without a known truth by two families on two forms first.  [default: the campaign's]",
)
@click.option("--timing/--no-timing", default=True, show_default=True, help="Time every success again, alone on a core.")
def run_command(
    file: Path, jobs: int | None, timing: bool, reference: Literal["none", "auto"] | None, **chosen: Any
) -> None:
    """Run problems x solvers x tolerances or steps into a store; what it holds already is not run again."""
    campaign = _campaign(**chosen)
    if chosen["name"] is None:
        refuse_misspelt(chosen["solvers"])
    if reference is not None:
        campaign = replace(campaign, reference=reference)
    with Store(file) as store:
        for repair in store.repairs:
            click.echo(f"{file}: {repair}", err=True)
        limits = machine_limits(jobs)
        references = auto_references(campaign, file, limits.jobs, partial(click.echo, err=True))
        done = run_campaign(
            campaign, store, limits=limits, references=references, timing=timing, progress=terminal_progress()
        )
    click.echo(_summary(done, file))


def _campaign(
    name: str | None,
    problems: tuple[str, ...],
    solvers: tuple[str, ...],
    rtol: tuple[str, ...],
    step: tuple[str, ...],
    steps: tuple[str, ...],
    max_seconds: float | None,
) -> Campaign:
    """The campaign of the options."""
    some = tuple(split_specs(problems)), tuple(split_specs(solvers))
    if name is None:
        grid = Grid(
            problems=some[0],
            solvers=some[1],
            rtol=_numbers("rtol", rtol, float),
            step=_numbers("step", step, float),
            steps=_numbers("steps", steps, int),
        )
        campaign = Campaign(grids=(grid,))
    elif rtol or step or steps:
        raise ProblemError(f"the campaign {name} has its own tolerances and steps; leave out --rtol, --step and --steps.")
    else:
        campaign = restrict(named_campaign(name), *some)
    return campaign if max_seconds is None else replace(campaign, max_seconds=max_seconds)


def refuse_misspelt(solvers: tuple[str, ...]) -> None:
    """Make every registered solver once, before anything runs: a wrong option is wrong use, not a row.

    Files are not executed here.  What cannot be imported, or fails otherwise, costs its own cells only.

    Raises
    ------
    ProblemError, TypeError
        There is no such solver, or it cannot be made with these options.
    """
    for text in split_specs(solvers):
        spec = parse_spec(text)
        if spec.path is not None:
            continue
        plugins.find("solver", spec.name)
        try:
            plugins.load("solver", spec.name)
        except ProblemError:  # its library is missing or broken
            continue
        try:
            load_solver(text)
        except (ProblemError, TypeError):
            raise
        except Exception:  # noqa: BLE001 - the plugin's own: the workers tell
            continue


def split_specs(texts: tuple[str, ...]) -> list[str]:
    """Specs separated by commas that are outside of brackets and quotes."""
    found = []
    for text in texts:
        depth, quote, start = 0, "", 0
        for i, character in enumerate(text):
            if quote:
                quote = "" if character == quote else quote
            elif character in "'\"" and depth:
                quote = character
            elif character in "([":
                depth += 1
            elif character in ")]":
                depth -= 1
            elif character == "," and depth == 0:
                found.append(text[start:i])
                start = i + 1
        found.append(text[start:])
    return [text.strip() for text in found if text.strip()]


def _numbers(name: str, texts: tuple[str, ...], kind: Any) -> tuple[Any, ...]:
    words = [word for text in texts for word in re.split(r"[,\s]+", text) if word]
    try:
        return tuple(kind(word) for word in words)
    except ValueError as error:
        raise ProblemError(f"--{name} takes numbers separated by commas; got {', '.join(words)}.") from error


def terminal_progress() -> Progress | None:
    """One line on the terminal; None where nobody looks."""
    if not sys.stderr.isatty():
        return None

    def tell(name: str, done: int, total: int) -> None:
        click.echo(f"\r{name}: {done} of {total} cells", err=True, nl=done == total)

    return tell


def _summary(done: Done, file: Path) -> str:
    """How many cells ended how, what did not end well, and where the rows are."""
    counts = Counter(row.status for row in done.rows)
    lines = [
        f"{row.status:>14}  {row.problem}  {row.solver}  {_asked(row.request)}: {row.message}"
        for row in done.rows
        if not row.success and row.status != "declined"
    ]
    declined = dict.fromkeys(
        f"{'declined':>14}  {row.problem}  {row.solver}: {row.message}" for row in done.rows if row.status == "declined"
    )
    lines += declined
    shown = lines[:MOST_SHOWN] + ([f"... and {len(lines) - MOST_SHOWN} more"] if len(lines) > MOST_SHOWN else [])
    ended = ", ".join(f"{count} {status}" for status, count in counts.most_common())
    work = f"{done.ran} run now, {done.timed} timed now"
    return "\n".join([*shown, f"{done.cells} cells: {ended} ({work}); rows in {file}"])


def _asked(request: dict[str, Any]) -> str:
    return ", ".join(f"{name}={request[name]:g}" for name in ("rtol", "step", "steps") if request[name] is not None)
