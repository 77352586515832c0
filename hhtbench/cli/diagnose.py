"""The command ``hhtbench diagnose``."""

from __future__ import annotations

from typing import Any

import click

from hhtbench.cli.output import Command, Found
from hhtbench.cli.solve import request_options, solved


@click.command("diagnose", cls=Command)
@click.argument("problem")
@request_options
def diagnose_command(problem: str, solver: str, **request: Any) -> Found:
    """Integrate PROBLEM; search for the cause of a failure, or check a success by an independent integration.

    For example: hhtbench diagnose andrews --solver hht --step 1e-3
    """
    _, solution = solved(problem, solver, request)
    found = solution.verify().doubt if solution.success else solution.diagnose()
    if solution.success:
        line = f"check: {found or 'nothing speaks against the solution.'}"
    else:
        line = f"cause: {found or 'none was found beyond the message.'}"
    facts = {"status": solution.status.label, "message": solution.message, "found": found}
    return Found(f"{solution.status.label}: {solution.message}\n{line}", facts, not solution.success or bool(found))
