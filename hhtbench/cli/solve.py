"""The command ``hhtbench solve``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hhtbench.cli.output import NEW_FILE, Command, Found, with_options
from hhtbench.runtime.interruption import ends_at_once

if TYPE_CHECKING:
    from hhtbench.protocol.problem import Problem
    from hhtbench.solution.result import Solution

request_options = with_options(  # which solver integrates, how, and within which budgets
    click.option("--solver", default="hht", show_default=True, help='For example "hht(alpha=-1/3, reaction=midpoint)".'),
    click.option("--step", type=float, help="Constant step [s]."),
    click.option("--steps", type=int, help="Number of equal steps."),
    click.option("--rtol", type=float, help="Relative tolerance: steps chosen by error control."),
    click.option("--atol", type=float, help="Absolute tolerance."),
    click.option(
        "--accuracy", type=float, help="Largest scaled error of q and v; the tolerance or step that meets it is searched."
    ),
    click.option("--max-num-steps", type=int, help="Most accepted steps."),
    click.option("--max-evaluations", type=int, help="Most residual evaluations."),
    click.option("--max-seconds", type=float, help="Most wall-clock time [s]."),
    click.option("--calc-initcond", is_flag=True, help="Project an inconsistent start onto the constraints."),
)


@click.command("solve", cls=Command)
@click.argument("problem")
@request_options
@click.option("--output", type=NEW_FILE, help="Save the solution to this .npz file.")
def solve_command(problem: str, solver: str, output: Path | None, **request: Any) -> Found:
    """Integrate PROBLEM; print status, counters, end state and, where it is known, the error.

    For example: hhtbench solve andrews --solver "ida(form=ggl)" --rtol 1e-6 --output run.npz
    """
    loaded, solution = solved(problem, solver, request)
    with ends_at_once():
        from hhtbench.cli.solution import as_dict, end_state, errors_at_end

    parts = [repr(solution), end_state(solution), errors_at_end(loaded, solution)]
    if output is not None:
        parts.append(f"written: {solution.save(output)}")
    return Found("\n\n".join(filter(None, parts)), as_dict(loaded, solution), not solution.success)


def solved(problem: str, solver: str, request: dict[str, Any]) -> tuple[Problem, Solution]:
    """Return the problem and its solution for the command-line options ``request``."""
    with ends_at_once():
        from hhtbench.api import solve
        from hhtbench.catalogue.registry import load_problem

    loaded = load_problem(problem)
    return loaded, solve(loaded, solver, **{name: value for name, value in request.items() if value is not None})
