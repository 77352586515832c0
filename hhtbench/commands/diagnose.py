"""The command ``hhtbench diagnose``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from hhtbench.commands.solve import request_options
from hhtbench.interruption import ends_at_once
from hhtbench.output import FAILED, json_option, require_folder, write_json


@click.command("diagnose")
@click.argument("problem")
@request_options
@json_option
def diagnose_command(problem: str, solver: str, json_file: Path | None, **request: Any) -> None:
    """Integrate PROBLEM; look for the cause of a failure, or check a success by the bench's own integration.

    For example: hhtbench diagnose andrews --solver hht --step 1e-3
    """
    with ends_at_once():
        from hhtbench.api import solve
        from hhtbench.registry import load_problem

    require_folder(json_file)
    solution = solve(load_problem(problem), solver, **{name: value for name, value in request.items() if value is not None})
    click.echo(f"{solution.status.label}: {solution.message}")
    found = solution.verify().doubt if solution.success else solution.diagnose()
    if solution.success:
        click.echo(f"check: {found or 'nothing speaks against the solution.'}")
    else:
        click.echo(f"cause: {found or 'none was found beyond the message.'}")
    write_json({"status": solution.status.label, "message": solution.message, "found": found}, json_file)
    sys.exit(0 if solution.success and not found else FAILED)
