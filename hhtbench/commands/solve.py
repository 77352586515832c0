"""The command ``hhtbench solve``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from hhtbench.interruption import ends_at_once
from hhtbench.output import FAILED, json_option, require_folder, write_json


def request_options(command: Any) -> Any:
    """Options that say which solver integrates, how, and within which budgets."""
    options = (
        click.option("--solver", default="hht", show_default=True, help='For example "hht(alpha=-1/3, reaction=midpoint)".'),
        click.option("--step", type=float, help="Constant step [s]."),
        click.option("--steps", type=int, help="Number of equal steps."),
        click.option("--rtol", type=float, help="Relative tolerance: steps chosen by error control."),
        click.option("--atol", type=float, help="Absolute tolerance."),
        click.option("--accuracy", type=float, help="Largest scaled error of q and v: the tolerance or step is found."),
        click.option("--max-num-steps", type=int, help="Most accepted steps."),
        click.option("--max-evaluations", type=int, help="Most residual evaluations."),
        click.option("--max-seconds", type=float, help="Most wall-clock time [s]."),
        click.option("--calc-initcond", is_flag=True, help="Project an inconsistent start onto the constraints."),
    )
    for option in reversed(options):
        command = option(command)
    return command


@click.command("solve")
@click.argument("problem")
@request_options
@json_option
@click.option("--output", type=click.Path(dir_okay=False, path_type=Path), help="Save the solution to this .npz file.")
def solve_command(problem: str, solver: str, output: Path | None, json_file: Path | None, **request: Any) -> None:
    """Integrate PROBLEM; print status, counters, end state and, where it is known, the error.

    For example: hhtbench solve andrews --solver "ida(form=ggl)" --rtol 1e-6 --output run.npz
    """
    with ends_at_once():
        from hhtbench.api import solve
        from hhtbench.commands.solution import as_dict, end_state, errors_at_end
        from hhtbench.registry import load_problem

    require_folder(output)
    require_folder(json_file)
    loaded = load_problem(problem)
    solution = solve(loaded, solver, **{name: value for name, value in request.items() if value is not None})
    click.echo(repr(solution))
    for text in (end_state(solution), errors_at_end(loaded, solution)):
        if text:
            click.echo(f"\n{text}")
    write_json(as_dict(loaded, solution), json_file)
    if output is not None:
        click.echo(f"\nwritten: {solution.save(output)}")
    sys.exit(0 if solution.success else FAILED)
