"""The command ``hhtbench run``."""

from __future__ import annotations

import shlex
import sys
from contextlib import AbstractContextManager, nullcontext
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hhtbench.cli.output import FILE, Command, Found, jobs_option, with_options
from hhtbench.protocol.errors import ProblemError
from hhtbench.runtime.interruption import Interrupted, ends_at_once, ends_in_order
from hhtbench.runtime.progress import progress

if TYPE_CHECKING:
    from concurrent.futures import Executor

campaign_options = with_options(  # what hhtbench.campaign.asked.asked_campaign takes
    click.option("--problems", multiple=True, help='Specs, "andrews, knife_edge(Om=3)"; may be given several times.'),
    click.option("--solvers", multiple=True, help='Specs, "hht(alpha=-0.1), ida(form=ggl)".'),
    click.option("--rtol", multiple=True, help='Relative tolerances, "1e-4, 1e-6".'),
    click.option("--step", multiple=True, help="Constant steps [s]."),
    click.option("--steps", multiple=True, help="Numbers of equal steps."),
    click.option("--campaign", "name", help="quick, full or FILE.toml; --problems and --solvers then choose a part of it."),
    click.option("--max-seconds", type=float, help="Most wall-clock time of one solve [s]."),
    click.option(
        "--reference",
        type=click.Choice(["none", "auto"]),
        help="auto: first certify problems without a reference by two methods.  [default: the campaign's]",
    ),
)


class Status(click.ParamType):
    """Parameter type for the label of a solve's status; the table of statuses is imported only when one is given."""

    name = "status"

    def __init__(self, *others: str) -> None:
        self._others = others

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return ``value`` if it is a known status; click reports the known ones otherwise."""
        from hhtbench.solution.result import Status as Known

        return str(click.Choice([*self._others, *(status.label for status in Known)]).convert(value, param, ctx))


@click.command("run", cls=Command)
@campaign_options
@click.option("--store", "file", type=FILE, required=True, help="SQLite file; resumed.")
@jobs_option
@click.option("--timing/--no-timing", default=True, show_default=True, help="Time every success again, alone on a core.")
@click.option(
    "--retry",
    multiple=True,
    type=Status(),
    metavar="STATUS",
    help="Run cells again that ended with this status, for example crashed.",
)
@click.option(
    "--fail-on",
    multiple=True,
    type=Status("any"),
    metavar="STATUS|any",
    help="Exit with 1 if a cell ended with this status; any: with any failure.",
)
@click.option(
    "--executor", type=click.Choice(["local", "dask"]), default="local", show_default=True, help="Where the cells run."
)
@click.option("--scheduler", help="Address of Dask's scheduler, tcp://HOST:PORT.")
def run_command(
    file: Path,
    jobs: int | None,
    timing: bool,
    retry: tuple[str, ...],
    fail_on: tuple[str, ...],
    executor: str,
    scheduler: str | None,
    **chosen: Any,
) -> Found:
    """Run problems x solvers x tolerances or steps and store the results; cells already in the store are not run again.

    Cells that fail are stored too: the exit code is 0, unless --fail-on says otherwise.

    For example: hhtbench run --problems "andrews, my.py:crane" --solvers "hht, ida" --rtol 1e-4,1e-6 --store runs.sqlite
    """
    if (executor == "dask") != (scheduler is not None):
        raise click.UsageError("--executor dask and --scheduler ADDRESS belong together.")
    command = shlex.join(["hhtbench", *sys.argv[1:]])
    resume = f"interrupted; what is done is in {file}. This goes on from there:\n{command}"
    with ends_at_once(resume):
        from hhtbench.campaign.asked import asked_campaign
        from hhtbench.campaign.campaign import run_campaign
        from hhtbench.campaign.execute import machine_limits
        from hhtbench.campaign.references import auto_references
        from hhtbench.campaign.store import Store
        from hhtbench.campaign.summary import facts_of, is_failure, text_of

        campaign = asked_campaign(**chosen)
        store = Store(file)
    for repair in store.repairs:
        click.echo(f"{file}: {repair}", err=True)
    try:
        with store, ends_in_order(resume), progress() as bar, _executor(scheduler) as cluster:
            limits = machine_limits(jobs)
            done = run_campaign(
                campaign,
                store,
                limits=limits,
                executor=cluster,
                references=auto_references(campaign, file, limits.jobs, bar.say),
                timing=timing,
                retry=retry,
                progress=bar.advance,
            )
    except Interrupted as interrupted:
        click.echo(f"\n{resume}", err=True)
        sys.exit(interrupted.code)
    failed = any(is_failure(row, fail_on) for row in done.rows)
    return Found(text_of(done, file), facts_of(done, file, store.repairs), failed)


def _executor(scheduler: str | None) -> AbstractContextManager[Executor | None]:
    """Return the executor of a Dask cluster; None stands for worker processes on this machine."""
    if scheduler is None:
        return nullcontext()
    try:
        cluster = import_module("hhtbench.campaign.cluster")
    except ImportError as error:
        raise ProblemError(f"--executor dask needs Dask: pip install 'hhtbench[dask]' ({error}).") from error
    executor: AbstractContextManager[Executor] = cluster.cluster_executor(scheduler)
    return executor
