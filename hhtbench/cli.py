"""The command ``hhtbench``.  Exit codes: 0 all well, 1 a claim fails or a solve stops early, 2 wrong use."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from hhtbench import plugins
from hhtbench.api import solve
from hhtbench.campaign.command import run_command
from hhtbench.campaign.machine import usable_cores
from hhtbench.check import check
from hhtbench.describe import describe
from hhtbench.drawing.command import show_command
from hhtbench.errors import ProblemError
from hhtbench.evidence import Evidence, read_evidence
from hhtbench.library import check_all
from hhtbench.processes import one_blas_thread
from hhtbench.reference.command import reference_command
from hhtbench.registry import load_problem, load_verification
from hhtbench.report import write_comparison, write_report
from hhtbench.report.solution import end_state, errors_at_end, save_solution
from hhtbench.store import load_rows
from hhtbench.validation.command import validate_command

WRONG_USE = 2
FAILED = 1


class Commands(click.Group):
    """A group that shows wrong use as one message and leaves with code 2."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; ``--traceback`` lets the exception through."""
        try:
            with warnings.catch_warnings():
                warnings.showwarning = _show_warning
                return super().invoke(ctx)
        except (ProblemError, TypeError, OSError) as error:
            if ctx.params.get("traceback"):
                raise
            click.echo(f"Error: {error}", err=True)
            ctx.exit(WRONG_USE)


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.option("-v", "--traceback", is_flag=True, help="Show where an error was raised.")
@click.version_option(package_name="hhtbench")
def main(traceback: bool) -> None:
    """Integrate constrained mechanical systems and choose a solver with evidence.

    PROBLEM is a name with parameters, "planar_chain(n_links=100)", or a file, "my_file.py:problem(k=1)".

    Exit codes: 0 all well; 1 a claim fails or a solve stops early; 2 wrong use.
    """
    one_blas_thread()


@main.command("list")
def list_command() -> None:
    """List problems, solvers and verifications."""
    for kind in plugins.GROUPS:
        names = plugins.names(kind)
        click.echo(f"{kind}s" + ("" if names else ": none registered"))
        width = max(map(len, names), default=0)
        for name in names:
            click.echo(f"  {name:{width}}  {plugins.summary(kind, name)}".rstrip())


@main.command("describe")
@click.argument("problem")
def describe_command(problem: str) -> None:
    """State what PROBLEM declares, what is therefore not computed, and how it is evaluated."""
    click.echo(str(describe(load_problem(problem))))


@main.command("check")
@click.argument("problem", required=False)
@click.option("--all", "every", is_flag=True, help="Check every registered problem.")
@click.option("--jobs", type=click.IntRange(min=1), help="Worker processes with --all.  [default: one a core]")
@click.option("--json", "json_file", type=click.Path(dir_okay=False, path_type=Path), help="Write the rows to this file.")
def check_command(problem: str | None, every: bool, jobs: int | None, json_file: Path | None) -> None:
    """Check that PROBLEM keeps its promises: shapes, derivatives, consistent start, rank, energy."""
    if every == (problem is not None):
        raise click.UsageError("name one PROBLEM, or give --all.")
    if problem is not None:
        _conclude(check(load_problem(problem)), json_file)
    _require_folder(json_file)
    evidence = check_all(jobs or usable_cores(), click.echo)
    if json_file is not None:
        evidence.write_json(json_file)
    wrong = [row for row in evidence.rows if row.passed is False]
    click.echo("".join(f"\n{row.id}: {row.measured} (bound: {row.bound})" for row in wrong))
    click.echo(f"{evidence.summary}; {evidence.seconds:.0f} s")
    sys.exit(0 if evidence.passed else FAILED)


@main.command("solve")
@click.argument("problem")
@click.option("--solver", default="hht", show_default=True, help='For example "hht(alpha=-1/3, reaction=midpoint)".')
@click.option("--step", type=float, help="Constant step [s].")
@click.option("--steps", type=int, help="Number of equal steps.")
@click.option("--rtol", type=float, help="Relative tolerance: steps chosen by error control.")
@click.option("--atol", type=float, help="Absolute tolerance.")
@click.option("--max-num-steps", type=int, help="Most accepted steps.")
@click.option("--max-evaluations", type=int, help="Most residual evaluations.")
@click.option("--max-seconds", type=float, help="Most wall-clock time [s].")
@click.option("--output", type=click.Path(dir_okay=False, path_type=Path), help="Write t, q, v, lam, mu to this .npz file.")
def solve_command(problem: str, solver: str, output: Path | None, **request: Any) -> None:
    """Integrate PROBLEM; print status, counters, end state and, where it is known, the error."""
    _require_folder(output)
    loaded = load_problem(problem)
    solution = solve(loaded, solver, **{name: value for name, value in request.items() if value is not None})
    click.echo(repr(solution))
    for text in (end_state(solution), errors_at_end(loaded, solution)):
        if text:
            click.echo(f"\n{text}")
    if output is not None:
        click.echo(f"\nwritten: {save_solution(solution, output)}")
    sys.exit(0 if solution.success else FAILED)


@main.command("verify")
@click.argument("name")
@click.option("--json", "json_file", type=click.Path(dir_okay=False, path_type=Path), help="Write the rows to this file.")
@click.option(
    "--report", "folder", type=click.Path(file_okay=False, path_type=Path), help="Write the report into this folder."
)
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Worker processes.")
def verify_command(name: str, json_file: Path | None, folder: Path | None, jobs: int) -> None:
    """Measure the claims of the verification NAME."""
    _require_folder(json_file)
    evidence = load_verification(name)(_progress(), jobs)
    if folder is not None:
        write_report(evidence, folder, f"hhtbench verify {name} --report {_shown(folder)}")
    _conclude(evidence, json_file)


main.add_command(run_command)
main.add_command(reference_command)
main.add_command(show_command)
main.add_command(validate_command)


@main.command("report")
@click.option("--store", required=True, type=click.Path(dir_okay=False, path_type=Path), help="The campaign's rows.")
@click.option(
    "--folder", required=True, type=click.Path(file_okay=False, path_type=Path), help="Write index.html and report.md here."
)
def report_command(store: Path, folder: Path) -> None:
    """Write the comparison of a campaign; a verification in the folder is shown with it."""
    claims = folder / "evidence.json"
    evidence = read_evidence(claims) if claims.is_file() else None
    command = f"hhtbench report --store {_shown(store)} --folder {_shown(folder)}"
    write_comparison(load_rows(store), folder, command, evidence)
    click.echo(f"written: {folder / 'index.html'}")


def _conclude(evidence: Evidence, json_file: Path | None) -> None:
    """Table, file and summary line; leave with 1 where a claim fails."""
    click.echo(evidence.table())
    if json_file is not None:
        _require_folder(json_file)
        evidence.write_json(json_file)
    click.echo(f"\n{evidence.summary}")
    sys.exit(0 if evidence.passed else FAILED)


def _progress() -> Callable[[str], None] | None:
    """Lines on stderr for a person who waits; None where nobody looks."""
    if not sys.stderr.isatty():
        return None
    return lambda text: click.echo(text, err=True)


def _require_folder(file: Path | None) -> None:
    """Before the work, not after it: the folder to write into must exist."""
    if file is not None and not file.name:
        raise ProblemError("give the name of a file to write; got an empty one.")
    if file is not None and not file.parent.is_dir():
        raise ProblemError(f"there is no folder {file.parent} to write {file.name} into; make it first.")


def _shown(folder: Path) -> str:
    """The folder as a reader elsewhere can use it: relative, without this machine's paths."""
    absolute = folder.resolve()
    return absolute.relative_to(Path.cwd()).as_posix() if absolute.is_relative_to(Path.cwd()) else folder.name


def _show_warning(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    """One line on stderr, without the place in the source."""
    click.echo(f"{category.__name__}: {message}", err=True)
