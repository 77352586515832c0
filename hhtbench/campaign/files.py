"""Campaigns as TOML files: every value checked against the fields of a campaign before anything runs."""

from __future__ import annotations

import re
import tomllib
from dataclasses import fields
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import msgspec

from hhtbench.campaign.plan import Campaign, Grid
from hhtbench.errors import NotFoundError, ProblemError

GRID = "grid"  # the tables [[grid]] of a file
WORDS = {  # as TOML says it
    "array": "a list",
    "str": "text",
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "object": "a table",
}
PLACE = re.compile(r"(?P<text>.*) - at `\$\.(?P<path>[^`]*)`$")


def named_campaign(name: str) -> Campaign:
    """The campaign of the file ``hhtbench/campaign/<name>.toml``, or of ``name`` itself where that ends in .toml.

    Raises
    ------
    NotFoundError
        There is no such campaign or file.
    ProblemError
        The file is not a campaign; the text tells file, line, key, what was expected and what came.
    """
    if name.endswith(".toml"):
        file = Path(name).expanduser()
        try:
            return read_campaign(file.read_text(encoding="utf-8-sig"), name)
        except FileNotFoundError as error:
            raise NotFoundError(f"there is no file {name} in {Path.cwd()}; give the path as seen from there.") from error
        except (OSError, UnicodeDecodeError) as error:
            raise ProblemError(f"the campaign {name} cannot be read: {error}.") from error
    folder = files("hhtbench.campaign")
    known = sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))
    if name not in known:
        raise NotFoundError(f"there is no campaign named {name!r}; known: {', '.join(known)}, or a file that ends in .toml.")
    return read_campaign((folder / f"{name}.toml").read_text(encoding="utf-8"), f"{name}.toml")


def read_campaign(text: str, file: str = "campaign") -> Campaign:
    """A campaign from TOML: fields of :class:`Campaign`, and ``[[grid]]`` tables with the fields of :class:`Grid`."""
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ProblemError(f"{file} is not TOML: {error}.") from error
    _refuse_unknown(file, text, table)
    try:
        others = {key: value for key, value in table.items() if key != GRID}
        return msgspec.convert({"grids": table.get(GRID, []), **others}, Campaign)
    except msgspec.ValidationError as error:
        raise ProblemError(_said(file, text, table, str(error))) from error


def _refuse_unknown(file: str, text: str, table: dict[str, Any]) -> None:
    """A key that no field has; msgspec passes over it in a dataclass."""
    known = [GRID, *(field.name for field in fields(Campaign) if field.name != "grids")]
    places: list[tuple[str, dict[str, Any], list[str]]] = [("", table, known)]
    grids = table.get(GRID, [])
    own = [field.name for field in fields(Grid)]
    if isinstance(grids, list):
        places += [(f"{GRID}[{i}].", grid, own) for i, grid in enumerate(grids) if isinstance(grid, dict)]
    for prefix, part, names in places:
        for key in part:
            if key not in names:
                close = get_close_matches(key, names, n=1)
                hint = f" Did you mean {close[0]}?" if close else ""
                line = _line(text, f"{prefix}{key}")
                raise ProblemError(f"{file}, line {line}: unknown key {prefix}{key}.{hint} Known: {', '.join(names)}.")


def _said(file: str, text: str, table: dict[str, Any], error: str) -> str:
    """File, line, key, expected, got."""
    match = PLACE.match(error)
    if match is None:  # the whole file: a key is missing
        return f"{file}: {_in_words(error)}."
    path = match["path"].replace("grids", GRID, 1) if match["path"].startswith("grids") else match["path"]
    came = _value(table, path)
    got = "" if came is None else f"; got {came!r}"
    expected = _choices(path) or _in_words(match["text"].partition(", got")[0]).lower()
    return f"{file}, line {_line(text, path)}: {path}: {expected}{got}."


def _choices(path: str) -> str:
    """What a key takes that has a few values; "" for others: msgspec names the type."""
    owner = Grid if path.startswith(GRID) else Campaign
    hint = get_type_hints(owner).get(path.rpartition(".")[2])
    return f"expected {' or '.join(get_args(hint))}" if get_origin(hint) is Literal else ""


def _in_words(text: str) -> str:
    for name, words in WORDS.items():
        text = text.replace(f"`{name}`", words)
    return text


def _value(table: dict[str, Any], path: str) -> Any:
    """What stands at ``path``; None where nothing does."""
    value: Any = table
    for step in re.findall(r"[^.\[\]]+", path):
        try:
            value = value[int(step)] if isinstance(value, list) else value[step]
        except (KeyError, IndexError, ValueError, TypeError):
            return None
    return value


def _line(text: str, path: str) -> int:
    """The line of a key, or of the table it is missing from."""
    steps = re.findall(r"[^.\[\]]+", path)
    grid, key = (
        (int(steps[1]), steps[2] if len(steps) > 2 else "") if steps[0] == GRID and len(steps) > 1 else (-1, steps[0])
    )
    now, header = -1, 1
    for number, line in enumerate(text.splitlines(), start=1):
        if re.match(rf"\s*\[\[\s*{GRID}\s*\]\]", line):
            now += 1
            header = number if now == grid else header
        elif now == grid and re.match(rf"\s*[\"']?{re.escape(key)}[\"']?\s*=", line):
            return number
    return header
