"""Read campaigns from TOML files and check every value against the fields of a campaign."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from dataclasses import fields
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec

from hhtbench.campaign.plan import Campaign, Grid
from hhtbench.protocol.errors import NotFoundError, ProblemError, did_you_mean

GRID = "grid"  # the tables [[grid]] of a file
WORDS = {"`array`": "a list", "`str`": "text", "`int`": "a whole number", "`float`": "a number", "`bool`": "true or false"}
WRONG = re.compile(r"(?P<text>.*?)(, got .*?)?( - at `\$\.(?P<place>[^`]*)`)?$")  # as msgspec says it


def named_campaign(name: str) -> Campaign:
    """Read the campaign ``hhtbench/campaign/<name>.toml``, or the file ``name`` if it ends in .toml.

    Raises
    ------
    NotFoundError
        There is no such campaign or file.
    ProblemError
        The file is not a campaign; the text names the file, the line, the key, what was expected and what came.
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
    """Read a campaign from TOML: fields of :class:`Campaign`, and ``[[grid]]`` tables with the fields of :class:`Grid`."""
    try:
        table = tomllib.loads(text)
        for place, key, known in _unknown(table):
            hint = did_you_mean(key, known)
            line = _line(text, place)
            raise ProblemError(f"{file}, line {line}: unknown key {place}.{hint} Known: {', '.join(known)}.")
        others = {key: value for key, value in table.items() if key != GRID}
        return msgspec.convert({"grids": table.get(GRID, []), **others}, Campaign)
    except tomllib.TOMLDecodeError as error:
        raise ProblemError(f"{file} is not TOML: {error}.") from error
    except msgspec.ValidationError as error:
        raise ProblemError(f"{file}, {_said(text, table, str(error))}") from error


def _unknown(table: dict[str, Any]) -> Iterator[tuple[str, str, list[str]]]:
    """Yield unknown keys as (place, key, known keys); msgspec ignores them in a dataclass."""
    known = [GRID, *(field.name for field in fields(Campaign) if field.name != "grids")]
    yield from ((key, key, known) for key in table if key not in known)
    grids, own = table.get(GRID), [field.name for field in fields(Grid)]
    for i, grid in enumerate(grids if isinstance(grids, list) else ()):
        yield from ((f"{GRID}[{i}].{key}", key, own) for key in grid if key not in own)


def _said(text: str, table: dict[str, Any], error: str) -> str:
    """Return msgspec's error as line, key, what was expected and what came."""
    found = WRONG.match(error)
    place = (found["place"] or "" if found else "").replace("grids", GRID, 1)
    came: Any = table
    for step in re.findall(r"\w+", place):
        came = came[int(step)] if isinstance(came, list) else came[step]
    expected = (found["text"] if found else error).replace("Expected", "expected")
    for name, word in WORDS.items():
        expected = expected.replace(name, word)
    got = f"; got {came!r}" if expected.startswith("expected") else ""
    return f"line {_line(text, place)}: {place}: {expected}{got}."


def _line(text: str, place: str) -> int:
    """Return the line number of a key, or of the table that lacks it."""
    steps = re.findall(r"\w+", place)
    grid = int(steps[1]) if steps[:1] == [GRID] and len(steps) > 1 else -1
    key = (steps[2:] if grid >= 0 else steps)[:1]
    now, header = -1, 1
    for number, line in enumerate(text.splitlines(), start=1):
        if re.match(rf"\s*\[\[\s*{GRID}\s*\]\]", line):
            now += 1
            header = number if now == grid else header
        elif now == grid and key and re.match(rf"\s*[\"']?{key[0]}[\"']?\s*=", line):
            return number
    return header
