"""The store: one SQLite file, one writer with one connection, every row with its hash.

Rollback journal and full synchronisation: SQLite before 3.51.3 can lose pages of a write-ahead log, and a row must be on
the disk before the cell counts as done.
"""

from __future__ import annotations

import hashlib
import json
import sqlite3
import warnings
from collections.abc import Iterable
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hhtbench.errors import ProblemError
from hhtbench.store.files import store_file, take_lock
from hhtbench.store.rows import RunRow

VERSION = 1
JSON_COLUMNS = ("request", "metrics", "series", "counters", "timing", "environment")
COLUMNS = (
    "key",
    "identity",
    "problem",
    "solver",
    "request",
    "status",
    "message",
    "metrics",
    "series",
    "counters",
    "timing",
    "environment",
    "created",
)  #: all but the hash
SCHEMA = (
    f"CREATE TABLE IF NOT EXISTS runs ({', '.join(f'{name} TEXT NOT NULL' for name in COLUMNS)}, "
    "sha256 TEXT NOT NULL, PRIMARY KEY (key), UNIQUE (identity))",
    "CREATE TABLE IF NOT EXISTS meta (name TEXT PRIMARY KEY, value TEXT NOT NULL)",
)
HEADER = b"SQLite format 3\0"
CHANGES = ", ".join(f"{name} = excluded.{name}" for name in (*COLUMNS, "sha256"))
INSERT = (  # a row that is written again keeps its place in the file, which is the order of load_rows
    f"INSERT INTO runs VALUES ({', '.join('?' * (len(COLUMNS) + 1))}) "
    f"ON CONFLICT (identity) DO UPDATE SET {CHANGES} ON CONFLICT (key) DO UPDATE SET {CHANGES}"
)


class Store:
    """Rows of one file; a context manager.  While it is open no other runner can open it.

    Opening checks the file and every row's hash.  What does not match is removed, so that its cell runs again, and said
    in :attr:`repairs`.

    Raises
    ------
    ProblemError
        Another runner has the file open, it is no store of this version, or it cannot be written.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = store_file(path)
        self.repairs: tuple[str, ...] = ()  #: what was found damaged on opening
        if not self.path.parent.is_dir():
            raise ProblemError(f"there is no folder {self.path.parent} for the store {self.path.name}; make it first.")
        self._lock = take_lock(self.path)
        try:
            self._connection = self._open()
        except BaseException:
            self._lock.close()
            raise

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file and let another runner have it."""
        self._connection.close()
        self._lock.close()

    def get(self, key: str) -> RunRow | None:
        """The row of ``key``, or None."""
        names = ", ".join((*COLUMNS, "sha256"))
        found = self._connection.execute(f"SELECT {names} FROM runs WHERE key = ?", (key,)).fetchone()
        return None if found is None or _hash(found[:-1]) != _as_text(found[-1]) else _row(list(found[:-1]))

    def put(self, row: RunRow, identity: str) -> None:
        """Write ``row``; it is on the disk when this returns.  A row of the same identity and another key goes.

        Raises
        ------
        ProblemError
            It cannot be written; what was written before stays.
        """
        row = row if row.created else RunRow(**{**vars(row), "created": datetime.now(UTC).isoformat(timespec="seconds")})
        texts = _texts(row, identity)
        try:
            with self._connection:
                self._connection.execute(INSERT, (*texts, _hash(texts)))
        except sqlite3.Error as error:
            raise ProblemError(
                f"{self.path} cannot be written: {error}. All rows written before are kept; the same command resumes."
            ) from error

    def _open(self) -> sqlite3.Connection:
        connection = self._sound_connection()
        _, damaged = _read(connection)
        if damaged:
            with connection:
                connection.executemany("DELETE FROM runs WHERE rowid = ?", [(rowid,) for rowid in damaged])
            self.repairs += (f"{len(damaged)} rows did not match their hash and were removed; their cells run again.",)
        return connection

    def _sound_connection(self) -> sqlite3.Connection:
        """A connection to a file that passes SQLite's check: the file itself, or a new one with the rows saved from it."""
        connection = None
        try:
            _refuse_foreign(self.path)
            connection = _connect(self.path)
            _require_version(connection, self.path)
            if connection.execute("PRAGMA integrity_check").fetchone() == (b"ok",):
                return connection
        except sqlite3.DatabaseError as error:
            if isinstance(error, sqlite3.OperationalError) and "malformed" not in str(error):
                raise ProblemError(f"the store {self.path} cannot be opened: {error}.") from error
        return self._rescue(connection)

    def _rescue(self, connection: sqlite3.Connection | None) -> sqlite3.Connection:
        """Set the damaged file aside and write the rows that can be read and match their hash into a new one."""
        saved, _ = _read(connection) if connection is not None else ([], [])
        if connection is not None:
            connection.close()
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S%f")
        aside = self.path.with_name(f"{self.path.name}.damaged-{stamp}")
        self.path.rename(aside)
        journal = self.path.with_name(f"{self.path.name}-journal")
        if journal.exists():
            journal.rename(aside.with_name(f"{aside.name}-journal"))
        fresh = _connect(self.path)
        _require_version(fresh, self.path)
        with fresh:
            for identity, row in saved:
                texts = _texts(row, identity)
                fresh.execute(INSERT, (*texts, _hash(texts)))
        self.repairs += (f"the file was damaged; {len(saved)} sound rows were saved from it, it is kept as {aside.name}.",)
        return fresh


def load_rows(path: str | Path) -> list[RunRow]:
    """The sound rows of a store, in the order in which their cells came in first.

    Nothing is written but what a killed runner left undone.  Damaged rows are left out, with a warning that counts them.

    Raises
    ------
    ProblemError
        There is no such file, or it is no store.
    """
    file = store_file(path)
    if not file.exists():
        raise ProblemError(f"there is no store {path}; `hhtbench run --store {path}` writes one.")
    try:
        with closing(_connect_existing(file)) as connection:
            connection.text_factory = bytes
            connection.execute("SELECT count(*) FROM meta").fetchone()
            sound, damaged = _read(connection)
    except sqlite3.Error as error:
        raise ProblemError(f"{path} cannot be read as a store: {error}.") from error
    if damaged:
        warnings.warn(f"{path}: {len(damaged)} damaged rows are left out; run the campaign again.", stacklevel=2)
    return [row for _, row in sound]


def _refuse_foreign(path: Path) -> None:
    """Raise for a file of something else, before anything is written into it; a damaged store passes."""
    if not path.exists() or path.stat().st_size == 0:
        return
    with path.open("rb") as file:
        start = file.read(len(HEADER))
    if sum(a == b for a, b in zip(start, HEADER, strict=False)) < len(HEADER) // 2:
        raise ProblemError(f"{path} is no store but another kind of file; name another.")
    with closing(_connect_existing(path)) as connection:
        tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    foreign = sorted(tables - {"runs", "meta"})
    if foreign:
        raise ProblemError(f"{path} is no store: it has a table {foreign[0]}; name another file.")


def _connect_existing(path: Path) -> sqlite3.Connection:
    """For reading; writable where it can be, since only then can SQLite roll back what a killed runner had begun."""
    uri = path.resolve().as_uri()
    connection = sqlite3.connect(f"{uri}?mode=rw", uri=True, timeout=30.0)
    try:
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.OperationalError:
        connection.close()
        return sqlite3.connect(f"{uri}?mode=ro", uri=True, timeout=30.0)
    return connection


def _connect(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, timeout=30.0)  # waits for a reader; a second writer is kept out by the lock
    connection.text_factory = bytes  # a damaged text need not be UTF-8
    connection.execute("PRAGMA journal_mode = DELETE")
    connection.execute("PRAGMA synchronous = FULL")
    return connection


def _require_version(connection: sqlite3.Connection, path: Path) -> None:
    with connection:
        for statement in SCHEMA:
            connection.execute(statement)
        connection.execute("INSERT OR IGNORE INTO meta VALUES ('version', ?)", (str(VERSION),))
    found = connection.execute("SELECT value FROM meta WHERE name = 'version'").fetchone()[0]
    if found != str(VERSION).encode():
        shown = found.decode(errors="replace")
        raise ProblemError(f"{path} is a store of version {shown}, this hhtbench writes version {VERSION}; use a new file.")


def _read(connection: sqlite3.Connection) -> tuple[list[tuple[str, RunRow]], list[int]]:
    """Identity and row of every sound row, and the rowids of the damaged ones; reads as far as the file can be read."""
    sound: list[tuple[str, RunRow]] = []
    damaged: list[int] = []
    names = ", ".join(("rowid", *COLUMNS, "sha256"))
    try:
        for rowid, *texts, digest in connection.execute(f"SELECT {names} FROM runs ORDER BY rowid"):
            row = _row(texts) if _hash(texts) == _as_text(digest) else None
            if row is None:
                damaged.append(rowid)
            else:
                sound.append((texts[1].decode(), row))
    except sqlite3.DatabaseError:
        return sound, damaged
    return sound, damaged


def _row(texts: list[Any]) -> RunRow | None:
    try:
        values = dict(zip(COLUMNS, (text.decode() for text in texts), strict=True))
        del values["identity"]
        return RunRow(**{k: json.loads(v) if k in JSON_COLUMNS else v for k, v in values.items()})
    except (ValueError, AttributeError):
        return None


def _texts(row: RunRow, identity: str) -> list[str]:
    """The columns as text; a number that is not finite is a mistake of the caller."""
    values: dict[str, Any] = {**vars(row), "identity": identity}
    return [json.dumps(values[k], allow_nan=False) if k in JSON_COLUMNS else values[k] for k in COLUMNS]


def _hash(texts: Iterable[Any]) -> str:
    """Over the lengths and texts, so that nothing moves from one column into the next."""
    digest = hashlib.sha256()
    for text in texts:
        content = text.encode() if isinstance(text, str) else text if isinstance(text, bytes) else repr(text).encode()
        digest.update(len(content).to_bytes(8, "little") + content)
    return digest.hexdigest()


def _as_text(value: Any) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)
