"""Options shared by the commands, and the output of a result as text, JSON and exit code."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from hhtbench.protocol.errors import ProblemError

if TYPE_CHECKING:
    from hhtbench.protocol.evidence import Evidence

FAILED = 1
FILE = click.Path(dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)


class NewFile(click.Path):
    """Parameter type for a file to be written; its folder must exist before the work begins."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; raise if its folder does not exist."""
        file: Any = super().convert(value, param, ctx)
        require_folder(file)
        return file


NEW_FILE = NewFile(dir_okay=False, path_type=Path)
json_option = click.option("--json", "json_file", type=NEW_FILE, help="Write what is found to this file, as JSON.")
jobs_option = click.option("--jobs", type=click.IntRange(min=1), help="Worker processes.  [default: one a core]")


@dataclass(frozen=True)
class Found:
    """Result of a :class:`Command`: text, JSON data and whether it failed."""

    text: object  #: for the terminal; "" if everything was printed already
    facts: Any  #: for --json
    failed: bool = False  #: the exit code is 1
    error: str = ""  #: printed on stderr; the exit code is 1


class Command(click.Command):
    """Command with the option ``--json`` whose function returns its result as :class:`Found`."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        json_option(self)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the command line; say that a solver is named by ``--solver`` where it follows the problem."""
        try:
            return super().parse_args(ctx, args)
        except click.UsageError as error:
            if "unexpected extra argument" in error.message and any(option.name == "solver" for option in self.params):
                raise click.UsageError(f"{error.message}; a solver is given by --solver.", ctx) from None
            raise

    def invoke(self, ctx: click.Context) -> NoReturn:
        """Call the function, print the text, write the JSON file and exit with the code."""
        file = ctx.params.pop("json_file")
        found: Found = super().invoke(ctx)
        if text := str(found.text):
            click.echo(text)
        write_json(found.facts, file)
        if found.error:
            click.echo(f"Error: {found.error}", err=True)
        sys.exit(FAILED if found.failed or found.error else 0)


def with_options(*options: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Combine several click options into one decorator; the help lists them in this order."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


def judged(evidence: Evidence) -> Found:
    """Turn Evidence into a :class:`Found`: its table and summary line; failed if a claim fails."""
    table = evidence.table(width=terminal_width())
    return Found(f"{table}\n\n{evidence.summary}", evidence.as_dict(), not evidence.passed)


def terminal_width() -> int | None:
    """Return the columns of the terminal; None if the output goes to a file or a pipe."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() or os.environ.get("COLUMNS") else None


def write_json(value: Any, file: Path | None) -> None:
    """Write ``value`` as JSON to ``file`` if it is not None; a number that is not finite becomes null."""
    if file is not None:
        from hhtbench.protocol.evidence import plain  # it loads NumPy, which `hhtbench list` does without

        require_folder(file)
        file.write_text(json.dumps(plain(value), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def require_folder(file: Path | None) -> None:
    """Raise unless the folder of ``file`` exists, so that an error comes before the work."""
    if file is not None and not file.name:
        raise ProblemError("give the name of a file to write; got an empty one.")
    if file is not None and not file.parent.is_dir():
        raise ProblemError(f"there is no folder {file.parent} to write {file.name} into; make it first.")


def shown(folder: Path) -> str:
    """Return the folder relative to the working folder if it lies in it, else its name: no path of this machine."""
    absolute = folder.resolve()
    return absolute.relative_to(Path.cwd()).as_posix() if absolute.is_relative_to(Path.cwd()) else folder.name
