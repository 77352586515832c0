"""The command ``hhtbench``.

Exit codes: 0 all well, 1 a claim fails or a solve stops early, 2 wrong use, 129, 130, 143 SIGHUP, Ctrl-C, SIGTERM.
"""

from __future__ import annotations

import warnings
from typing import Any

import click

from hhtbench.cli.check import check_command
from hhtbench.cli.describe import describe_command
from hhtbench.cli.diagnose import diagnose_command
from hhtbench.cli.list import list_command
from hhtbench.cli.reference import reference_command
from hhtbench.cli.report import report_command
from hhtbench.cli.run import run_command
from hhtbench.cli.select import select_command
from hhtbench.cli.show import show_command
from hhtbench.cli.solve import solve_command
from hhtbench.cli.status import status_command
from hhtbench.cli.study import study_command
from hhtbench.cli.trade import trade_command
from hhtbench.cli.validate import validate_command
from hhtbench.cli.verify import verify_command
from hhtbench.protocol.errors import ProblemError
from hhtbench.runtime.interruption import Interrupted, ends_in_order
from hhtbench.runtime.processes import one_blas_thread

WRONG_USE = 2
COMMANDS = (
    check_command,
    describe_command,
    diagnose_command,
    list_command,
    reference_command,
    report_command,
    run_command,
    select_command,
    show_command,
    solve_command,
    status_command,
    study_command,
    trade_command,
    validate_command,
    verify_command,
)


class Commands(click.Group):
    """Command group that prints wrong use as one message and exits with code 2."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands, each with the whole first sentence of its help."""
        with formatter.section("Commands"):
            rows = [(name, (self.commands[name].help or "").partition("\n\n")[0]) for name in sorted(self.commands)]
            formatter.write_dl(rows)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command and turn its exceptions into messages and exit codes; ``--traceback`` lets them through."""
        one_blas_thread()  # before the command's module loads NumPy
        try:
            with ends_in_order(), warnings.catch_warnings():
                warnings.showwarning = _show_warning
                return super().invoke(ctx)
        except (ProblemError, TypeError, OSError) as error:
            if ctx.params.get("traceback") or isinstance(error, BrokenPipeError):  # click ends `| head` quietly
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


for command in COMMANDS:
    main.add_command(command)


def _show_warning(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    """Print a warning as one line on stderr, without its place in the source."""
    click.echo(f"{category.__name__}: {message}", err=True)
