"""What commands say and ask for: the option --json and its file, and a table of evidence with its exit code."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from hhtbench.errors import ProblemError

if TYPE_CHECKING:
    from hhtbench.evidence import Evidence

FAILED = 1

json_option = click.option(
    "--json", "json_file", type=click.Path(dir_okay=False, path_type=Path), help="Write what is found to this file, as JSON."
)


def write_json(value: Any, file: Path | None) -> None:
    """``value`` into ``file``, if one is asked for; a number that is not finite is null."""
    if file is not None:
        from hhtbench.evidence import plain  # it loads NumPy, which `hhtbench list` does without

        require_folder(file)
        file.write_text(json.dumps(plain(value), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def conclude(evidence: Evidence, json_file: Path | None) -> NoReturn:
    """Table, file and summary line; leave with 1 where a claim fails."""
    click.echo(evidence.table())
    if json_file is not None:
        require_folder(json_file)
        evidence.write_json(json_file)
    click.echo(f"\n{evidence.summary}")
    sys.exit(0 if evidence.passed else FAILED)


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
