"""Shared by the commands: common options, and the output of a result as text, JSON and exit code."""

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
    """A file to be written: before the work, not after it, its folder must exist."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path of the file."""
        file: Any = super().convert(value, param, ctx)
        require_folder(file)
        return file


NEW_FILE = NewFile(dir_okay=False, path_type=Path)
json_option = click.option("--json", "json_file", type=NEW_FILE, help="Write what is found to this file, as JSON.")
jobs_option = click.option("--jobs", type=click.IntRange(min=1), help="Worker processes.  [default: one a core]")


@dataclass(frozen=True)
class Found:
    """What a :class:`Command` has found."""

    text: object  #: for the terminal; "" where all has been said
    facts: Any  #: for --json
    failed: bool = False  #: the exit code is 1
    error: str = ""  #: said on stderr; the exit code is 1


class Command(click.Command):
    """A command whose function returns what it has :class:`Found`; it has the option ``--json``."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        json_option(self)

    def invoke(self, ctx: click.Context) -> NoReturn:
        """Call the function, write text and file, leave with the exit code."""
        file = ctx.params.pop("json_file")
        found: Found = super().invoke(ctx)
        if text := str(found.text):
            click.echo(text)
        write_json(found.facts, file)
        if found.error:
            click.echo(f"Error: {found.error}", err=True)
        sys.exit(FAILED if found.failed or found.error else 0)


def with_options(*options: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Options that commands share, as one decorator; the help shows them in this order."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


def judged(evidence: Evidence) -> Found:
    """A table of claims and its summary line; failed where a claim fails."""
    table = evidence.table(width=terminal_width())
    return Found(f"{table}\n\n{evidence.summary}", evidence.as_dict(), not evidence.passed)


def terminal_width() -> int | None:
    """Characters that fit into a line of the terminal; None where the output goes into a file or a pipe."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() or os.environ.get("COLUMNS") else None


def write_json(value: Any, file: Path | None) -> None:
    """``value`` into ``file``, if one is asked for; a number that is not finite is null."""
    if file is not None:
        from hhtbench.protocol.evidence import plain  # it loads NumPy, which `hhtbench list` does without

        require_folder(file)
        file.write_text(json.dumps(plain(value), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def require_folder(file: Path | None) -> None:
    """Before the work, not after it: the folder to write into must exist."""
    if file is not None and not file.name:
        raise ProblemError("give the name of a file to write; got an empty one.")
    if file is not None and not file.parent.is_dir():
        raise ProblemError(f"there is no folder {file.parent} to write {file.name} into; make it first.")


def shown(folder: Path) -> str:
    """The folder as a reader elsewhere can use it: relative, without this machine's paths."""
    absolute = folder.resolve()
    return absolute.relative_to(Path.cwd()).as_posix() if absolute.is_relative_to(Path.cwd()) else folder.name
