"""The command ``hhtbench run``."""

from __future__ import annotations

import re
import shlex
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import click

from hhtbench import plugins
from hhtbench.campaign.campaign import Done, Progress, run_campaign
from hhtbench.campaign.execute import machine_limits
from hhtbench.campaign.files import named_campaign
from hhtbench.campaign.plan import Campaign, Grid, restrict
from hhtbench.campaign.public import Runs
from hhtbench.campaign.references import auto_references
from hhtbench.errors import ProblemError
from hhtbench.interruption import Interrupted, ends_at_once, ends_in_order
from hhtbench.output import json_option, require_folder, write_json
from hhtbench.registry import load_solver
from hhtbench.result import Status
from hhtbench.specs import parse_spec
from hhtbench.store import RunRow, Store

MOST_SHOWN = 12  # kinds of failures on the terminal; the store holds all
ANY = "any"  # status that is neither success, event nor declined
STATUS = click.Choice([status.label for status in Status])
FAILURE = click.Choice([ANY, *STATUS.choices])


@click.command("run")
@click.option("--problems", multiple=True, help='Specs, "andrews, knife_edge(Om=3)"; may be given several times.')
@click.option("--solvers", multiple=True, help='Specs, "hht(alpha=-0.1), ida(form=ggl)".')
@click.option("--rtol", multiple=True, help='Relative tolerances, "1e-4, 1e-6".')
@click.option("--step", multiple=True, help="Constant steps [s].")
@click.option("--steps", multiple=True, help="Numbers of equal steps.")
@click.option("--campaign", "name", help="quick, full or FILE.toml; --problems and --solvers then choose a part of it.")
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
@click.option(
    "--retry", multiple=True, type=STATUS, metavar="STATUS", help="Run cells again that ended so, crashed for instance."
)
@click.option(
    "--fail-on", multiple=True, type=FAILURE, metavar="STATUS|any", help="Exit with 1 where a cell ended so; any: not well."
)
@click.option(
    "--executor", type=click.Choice(["local", "dask"]), default="local", show_default=True, help="Who runs the cells."
)
@click.option("--scheduler", help="Address of Dask's scheduler, tcp://HOST:PORT.")
@json_option
def run_command(
    file: Path,
    json_file: Path | None,
    jobs: int | None,
    timing: bool,
    retry: tuple[str, ...],
    fail_on: tuple[str, ...],
    executor: str,
    reference: Literal["none", "auto"] | None,
    scheduler: str | None,
    **chosen: Any,
) -> None:
    """Run problems x solvers x tolerances or steps into a store; what it holds already is not run again.

    Cells that fail are rows like others: the exit code is 0, unless --fail-on says otherwise.
    """
    if (executor == "dask") != (scheduler is not None):
        raise click.UsageError("--executor dask and --scheduler ADDRESS belong together.")
    require_folder(json_file)
    resume = f"interrupted; what is done is in {file}. This goes on from there:\n{_command_line()}"
    with ends_at_once(resume):
        campaign = _campaign(**chosen)
        if chosen["name"] is None:
            refuse_misspelt(chosen["solvers"])
        if reference is not None:
            campaign = replace(campaign, reference=reference)
        store = Store(file)
    for repair in store.repairs:
        click.echo(f"{file}: {repair}", err=True)
    try:
        with store, ends_in_order(resume), _executor(scheduler) as cluster:
            limits = machine_limits(jobs)
            references = auto_references(campaign, file, limits.jobs, partial(click.echo, err=True))
            done = run_campaign(
                campaign,
                store,
                limits=limits,
                executor=cluster,
                references=references,
                timing=timing,
                retry=retry,
                progress=terminal_progress(),
            )
    except Interrupted as interrupted:
        click.echo(f"\n{resume}", err=True)
        sys.exit(interrupted.code)
    click.echo(_summary(done, file))
    write_json(_facts(done, file, store.repairs), json_file)
    sys.exit(1 if any(_fails(row, fail_on) for row in done.rows) else 0)


def _command_line() -> str:
    return shlex.join(["hhtbench", *sys.argv[1:]])


def _executor(scheduler: str | None) -> AbstractContextManager[Executor | None]:
    """The cluster's; None: worker processes here."""
    if scheduler is None:
        return nullcontext()
    try:
        cluster = import_module("hhtbench.campaign.cluster")
    except ImportError as error:
        raise ProblemError(f"--executor dask needs Dask: pip install 'hhtbench[dask]' ({error}).") from error
    executor: AbstractContextManager[Executor] = cluster.cluster_executor(scheduler)
    return executor


def _fails(row: RunRow, fail_on: tuple[str, ...]) -> bool:
    return row.status in fail_on or (ANY in fail_on and not row.success and row.status != Status.declined.label)


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
    lines = _failures([row for row in done.rows if not row.success])
    shown = lines[:MOST_SHOWN] + ([f"... and {len(lines) - MOST_SHOWN} more lines"] if len(lines) > MOST_SHOWN else [])
    shown += [
        f"{row.problem}  {row.solver}  {_asked(row.request)}: came out otherwise a second time; the first row stays"
        for row in done.contradictions
    ]
    ended = ", ".join(f"{count} {status}" for status, count in counts.most_common())
    work = f"{done.ran} run now, {done.timed} timed now"
    return "\n".join([*shown, f"{done.cells} cells: {ended} ({work}); rows in {file}"])


def _facts(done: Done, file: Path, repairs: Sequence[str]) -> dict[str, Any]:
    """The same as plain values, and the numbers of every cell."""
    return {
        "store": str(file),
        "repairs": list(repairs),
        "cells": done.cells,
        "run": done.ran,
        "timed": done.timed,
        "ended": Counter(row.status for row in done.rows),
        "contradictions": [{"problem": row.problem, "solver": row.solver, **row.request} for row in done.contradictions],
        "rows": Runs(done.rows).table(),
    }


def _failures(rows: list[RunRow]) -> list[str]:
    """One line for each status and message, with the number of cells that ended so; what was declined comes last."""
    alike: dict[tuple[str, str], list[RunRow]] = {}
    for row in rows:
        alike.setdefault((row.status, row.message), []).append(row)
    lines = []
    for (status, message), some in sorted(alike.items(), key=lambda item: item[0][0] == Status.declined.label):
        problems = _one_of(list(dict.fromkeys(row.problem for row in some)))
        solvers = _one_of(list(dict.fromkeys(row.solver for row in some)))
        cells = _asked(some[0].request) if len(some) == 1 else f"{len(some)} cells"
        lines.append(f"{status:>14}  {problems}  {solvers}  {cells}: {message}")
    return lines


def _one_of(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"


def _asked(request: dict[str, Any]) -> str:
    return ", ".join(f"{name}={request[name]:g}" for name in ("rtol", "step", "steps") if request[name] is not None)
