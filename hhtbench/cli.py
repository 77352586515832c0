"""The command ``hhtbench``.

Exit codes: 0 all well, 1 a claim fails or a solve stops early, 2 wrong use, 129, 130, 143 SIGHUP, Ctrl-C, SIGTERM.
"""

from __future__ import annotations

import warnings
from importlib import import_module
from typing import Any

import click

from hhtbench.errors import ProblemError
from hhtbench.interruption import Interrupted, ends_at_once, ends_in_order
from hhtbench.processes import one_blas_thread

WRONG_USE = 2

COMMANDS = {  # module, and the first sentence of the command's own help: the overview imports no command
    "check": (
        "commands.check",
        "Check that PROBLEM keeps its promises: shapes, derivatives, consistent start, rank, energy.",
    ),
    "describe": (
        "commands.describe",
        "State what PROBLEM declares, what is therefore not computed, and how it is evaluated.",
    ),
    "diagnose": (
        "commands.diagnose",
        "Integrate PROBLEM; look for the cause of a failure, or check a success by the bench's own integration.",
    ),
    "list": ("commands.list", "List problems, solvers and verifications."),
    "reference": ("commands.reference", "Certified reference solutions with error bars."),
    "report": (
        "commands.report",
        "Write the comparison of a campaign as a page; without --folder print its summary, at most 200 lines.",
    ),
    "run": (
        "commands.run",
        "Run problems x solvers x tolerances or steps into a store; what it holds already is not run again.",
    ),
    "select": (
        "commands.select",
        "Say which solver reaches an error on PROBLEM most cheaply, with the evidence; exit 1 where it cannot be told.",
    ),
    "show": (
        "commands.show",
        "Draw the motion of PROBLEM from its sketch: phases in one picture (.png, .svg) or a film (.gif, .html).",
    ),
    "solve": (
        "commands.solve",
        "Integrate PROBLEM; print status, counters, end state and, where it is known, the error.",
    ),
    "status": ("commands.status", "Say what the store of a campaign holds, and what is left to do."),
    "study": ("commands.study", "Studies of the bench's own advice, of solvers at their extremes, of parts and reductions."),
    "trade": (
        "commands.trade",
        "Measure on PROBLEM who reaches an error most cheaply: table, plots and one sentence.",
    ),
    "validate": (
        "commands.validate",
        "Solve PROBLEMS by 15 pairs of solver and form and at constant steps; exit 1 where one disagrees.",
    ),
    "verify": ("commands.verify", "Measure the claims of the verification NAME."),
}


class Commands(click.Group):
    """Imports the module of the command that is asked for; shows wrong use as one message and leaves with code 2."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """All names."""
        return sorted(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command ``NAME`` is ``NAME_command`` of its module."""
        if cmd_name not in COMMANDS:
            return None
        with ends_at_once():
            command: click.Command = getattr(import_module(f"hhtbench.{COMMANDS[cmd_name][0]}"), f"{cmd_name}_command")
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The overview, from the table."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name][1]) for name in self.list_commands(ctx)])

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; ``--traceback`` lets the exception through."""
        one_blas_thread()  # before the command's module loads NumPy
        try:
            with ends_in_order(), warnings.catch_warnings():
                warnings.showwarning = _show_warning
                return super().invoke(ctx)
        except (ProblemError, TypeError, OSError) as error:
            if ctx.params.get("traceback"):
                raise
            click.echo(f"Error: {error}", err=True)
            ctx.exit(WRONG_USE)
        except Interrupted as interrupted:
            click.echo("interrupted", err=True)
            ctx.exit(interrupted.code)


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.option("-v", "--traceback", is_flag=True, help="Show where an error was raised.")
@click.version_option(package_name="hhtbench")
def main(traceback: bool) -> None:
    """Integrate constrained mechanical systems and choose a solver with evidence.

    PROBLEM is a name with parameters, "planar_chain(n_links=100)", or a file, "my_file.py:problem(k=1)".

    Exit codes: 0 all well; 1 a claim fails or a solve stops early; 2 wrong use; 130 interrupted (129, 143 by
    SIGHUP, SIGTERM).
    """


def _show_warning(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    """One line on stderr, without the place in the source."""
    click.echo(f"{category.__name__}: {message}", err=True)
