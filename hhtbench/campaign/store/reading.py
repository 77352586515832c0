"""Read everything that can be read from a store's file, and report damage."""

from __future__ import annotations

import json
import sqlite3
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hhtbench.campaign.store.columns import COLUMNS, hash_of, row_of, shown
from hhtbench.campaign.store.rows import RunRow
from hhtbench.protocol.errors import ProblemError

VERSION = 2
ERRORS = (sqlite3.Error, UnicodeDecodeError)  # the second: Python cannot word SQLite's message about damaged names
DAMAGE = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR)  # the last: a table's name is not found
MOST_NAMED = 8  # damaged rows that a message names
SELECT = f"SELECT rowid, {', '.join((*COLUMNS, 'sha256'))} FROM runs"


@dataclass(frozen=True, kw_only=True)
class Reading:
    """Rows read from a file, and its damage."""

    sound: tuple[tuple[str, RunRow], ...]  #: identity and row, those that match their hash
    damaged: tuple[str, ...]  #: the rows that do not or cannot be read, by name as far as that can be read
    fault: str  #: what SQLite's check says of the file, "" where it is sound

    @property
    def whole(self) -> bool:
        """True if nothing is damaged."""
        return not self.damaged and not self.fault

    @property
    def losses(self) -> str:
        """Describe what could not be read, as a sentence."""
        if not self.damaged and not self.sound and self.fault:
            return f"none of its rows can be read ({self.fault})"
        if not self.damaged:
            return f"no row is known to be lost ({self.fault})" if self.fault else ""
        count = len(self.damaged)
        names = "; ".join(self.damaged[:MOST_NAMED]) + (f"; and {count - MOST_NAMED} more" if count > MOST_NAMED else "")
        return f"{count} {'row' if count == 1 else 'rows'} cannot be read: {names}"

    def warning(self, path: Any) -> str:
        """Return a warning about damage of the file ``path`` with the advice, "" if there is none."""
        return "" if self.whole else f"{path} is damaged: {self.losses}; run the campaign again."


def damage(error: Exception) -> str:
    """Describe an SQLite error as damage of the file; re-raise a lock, a full disk or an unreachable file."""
    if isinstance(error, sqlite3.Error) and getattr(error, "sqlite_errorcode", 0) & 0xFF not in DAMAGE:
        raise error
    return str(error) if isinstance(error, sqlite3.Error) else "damaged names in its schema"


def found_version(connection: sqlite3.Connection) -> str | None:
    """Return the version of the store's schema; None if the file states none."""
    try:
        found = connection.execute("SELECT value FROM meta WHERE name = 'version'").fetchone()
    except ERRORS as error:
        damage(error)
        return None
    return None if found is None else shown(found[0])


def refuse_other_version(connection: sqlite3.Connection, path: Path) -> None:
    """Raise for a store of another schema version, before anything is read from it or written into it."""
    found = found_version(connection)
    if found is not None and found != str(VERSION):
        raise ProblemError(f"{path} is a store of version {found}, this hhtbench knows version {VERSION}; use a new file.")


def read(connection: sqlite3.Connection) -> Reading:
    """Read every row of the table; behind a damaged page, read the rows one by one.

    The connection must return bytes for text.
    """
    fault = _fault(connection)
    sound: list[tuple[str, RunRow]] = []
    damaged: list[str] = []
    seen: set[int] = set()
    try:
        for found in connection.execute(f"{SELECT} ORDER BY rowid"):
            seen.add(found[0])
            _sort_in(found, sound, damaged)
    except ERRORS as error:
        fault = fault or damage(error)
    for rowid in sorted(_rowids(connection) - seen) if fault else ():
        try:
            found = connection.execute(f"{SELECT} WHERE rowid = ?", (rowid,)).fetchone()
        except ERRORS as error:
            damage(error)
            found = None
        if found is None or found[0] != rowid:
            damaged.append(f"number {rowid} in the file")
        else:
            _sort_in(found, sound, damaged)
    return Reading(sound=tuple(sound), damaged=tuple(damaged), fault=fault)


def _fault(connection: sqlite3.Connection) -> str:
    try:
        found = shown(connection.execute("PRAGMA integrity_check(1)").fetchone()[0])
    except ERRORS as error:
        return damage(error)
    return "" if found == "ok" else " ".join(found.removeprefix("*** in database main ***").split())


def _sort_in(found: tuple[Any, ...], sound: list[tuple[str, RunRow]], damaged: list[str]) -> None:
    rowid, *texts, digest = found
    row = row_of(texts) if hash_of(texts) == shown(digest) else None
    if row is None:
        damaged.append(_name(rowid, dict(zip(COLUMNS, texts, strict=True))))
    else:
        sound.append((texts[1].decode(), row))


def _name(rowid: int, columns: dict[str, Any]) -> str:
    """Name a damaged row by problem, solver and request, as far as they can be read."""
    names = [shown(columns[name])[:80] for name in ("problem", "solver") if columns[name] is not None]
    try:
        asked = json.loads(columns["request"])
        names += [f"{name}={asked[name]:g}" for name in ("rtol", "step", "steps") if asked.get(name) is not None]
    except (ValueError, TypeError, AttributeError):
        pass
    return f"{', '.join(names)} (number {rowid} in the file)" if names else f"number {rowid} in the file"


def _rowids(connection: sqlite3.Connection) -> set[int]:
    """Return the numbers of all rows, from the indexes and from both ends of the table, as far as each can be read."""
    found: set[int] = set()
    for how in (
        "runs INDEXED BY sqlite_autoindex_runs_1 ORDER BY key",
        "runs INDEXED BY sqlite_autoindex_runs_2 ORDER BY identity",
        "runs NOT INDEXED ORDER BY rowid DESC",
    ):
        try:
            for (rowid,) in connection.execute(f"SELECT rowid FROM {how}"):
                if isinstance(rowid, int) and rowid > 0:
                    found.add(rowid)
        except ERRORS as error:
            damage(error)
    return found
