"""The store: one SQLite file, one writer with one connection, every row with its hash.

Rollback journal: SQLite before 3.51.3 can lose pages of a write-ahead log.  Synchronisation "extra": a row must be on the
disk before the cell counts as done, and with "full" the end of a transaction, the journal's removal from its folder, is not;
after a power failure the journal would be there again and undo it.
"""

from __future__ import annotations

import sqlite3
import warnings
from collections.abc import Iterable
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from hhtbench.campaign.store.columns import COLUMNS, PACKED, hash_of, row_of, shown, texts_of
from hhtbench.campaign.store.files import count_of_changes, leave_count, left_count, store_file, take_lock
from hhtbench.campaign.store.reading import ERRORS, VERSION, Reading, damage, read, refuse_other_version
from hhtbench.campaign.store.rows import RunRow
from hhtbench.protocol.errors import ProblemError

KINDS = {name: "BLOB" if name == PACKED else "TEXT" for name in COLUMNS}
SCHEMA = (
    f"CREATE TABLE IF NOT EXISTS runs ({', '.join(f'{name} {kind} NOT NULL' for name, kind in KINDS.items())}, "
    "sha256 TEXT NOT NULL, PRIMARY KEY (key), UNIQUE (identity))",
    "CREATE TABLE IF NOT EXISTS meta (name TEXT PRIMARY KEY, value TEXT NOT NULL)",
)
HEADER = b"SQLite format 3\0"
CHANGES = ", ".join(f"{name} = excluded.{name}" for name in (*COLUMNS, "sha256"))
INSERT = (  # a row that is written again keeps its place in the file, which is the order of load_rows
    f"INSERT INTO runs VALUES ({', '.join('?' * (len(COLUMNS) + 1))}) "
    f"ON CONFLICT (identity) DO UPDATE SET {CHANGES} ON CONFLICT (key) DO UPDATE SET {CHANGES}"
)
RESULT = ("status", "metrics", "counters")  # what two runs of the same key must agree in; times differ always


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A row to be written."""

    row: RunRow
    identity: str  #: a row of the same identity and another key is out of date and goes
    replaces: bool = False  #: takes the place of a row of the same key; otherwise the first stays


class Store:
    """Rows of one SQLite file; a context manager.  While it is open no other runner can open it, by whatever link.

    Opening checks the file and every row's hash.  A damaged file is renamed; what can be read of it goes into a new
    one, and the loss is described in :attr:`repairs`: those cells run again.

    Raises
    ------
    ProblemError
        Another runner has the file open, it is no store of this version, or it cannot be written.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = store_file(path)
        self.repairs: tuple[str, ...] = ()  #: what was found damaged on opening
        self._file = (
            self.path.resolve()
        )  # the lock, the journal and what is set aside lie beside the file, not beside a link
        if not self._file.parent.is_dir():
            raise ProblemError(f"there is no folder {self._file.parent} for the store {self.path.name}; make it first.")
        self._lock = take_lock(self._file)
        left = left_count(self._lock) if self._file.exists() else 0
        try:
            self._connection = self._open()
            self._bytes = self._file.open("rb", buffering=0)  # closed last: that would let go of SQLite's own locks
        except BaseException:
            self._lock.close()
            raise
        self._find_older(left)

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file and release its lock."""
        self._connection.close()
        self._bytes.close()
        self._lock.close()

    def get(self, key: str) -> RunRow | None:
        """Return the row with ``key``, or None."""
        names = ", ".join((*COLUMNS, "sha256"))
        try:
            found = self._connection.execute(f"SELECT {names} FROM runs WHERE key = ?", (key,)).fetchone()
        except sqlite3.Error as error:
            raise ProblemError(f"{self.path} cannot be read: {error}.") from error
        return None if found is None or hash_of(found[:-1]) != shown(found[-1]) else row_of(list(found[:-1]))

    def put(self, row: RunRow, identity: str) -> None:
        """Write ``row``, replacing one of the same key; see :meth:`write`."""
        self.write([Entry(row=row, identity=identity, replaces=True)])

    def write(self, entries: Iterable[Entry]) -> list[RunRow]:
        """Write rows; all are on the disk when this returns.  The first row of a key stays, unless ``replaces`` is set.

        Returns
        -------
        list
            Rows that were left out and whose result differs from that of the row that stays.

        Raises
        ------
        ProblemError
            They cannot be written; what was written before stays.
        """
        try:
            with self._connection:
                differing = [entry.row for entry in entries if not self._write(entry)]
        except sqlite3.Error as error:
            raise ProblemError(
                f"{self.path} cannot be written: {error}. All rows written before are kept; the same command resumes."
            ) from error
        leave_count(self._lock, self._bytes)
        return differing

    def _find_older(self, left: int) -> None:
        """Record in :attr:`repairs` if the file has fewer changes than the ``left`` ones of the last runner (an older
        copy).
        """
        now = count_of_changes(self._bytes)
        if not self.repairs and now < left:
            text = (
                f"the file is an older copy: it has been changed {now} times, the last runner left it after {left} changes"
            )
            self.repairs = (f"{text}; rows that were written since are gone, their cells run again.",)
        leave_count(self._lock, self._bytes)

    def _write(self, entry: Entry) -> bool:
        """Write one row; return False if a different result of the same key is there, which stays."""
        row = entry.row
        first = None if entry.replaces else self.get(row.key)
        if first is not None:
            return all(getattr(first, name) == getattr(row, name) for name in RESULT)
        row = row if row.created else replace(row, created=datetime.now(UTC).isoformat(timespec="seconds"))
        texts = texts_of(row, entry.identity)
        self._connection.execute(INSERT, (*texts, hash_of(texts)))
        return True

    def _open(self) -> sqlite3.Connection:
        """Open a connection to an undamaged file: the existing one, or a new one with the rows saved from it."""
        if self._file.exists() and self._file.stat().st_size == 0:  # touched, or cut off: that cannot be told apart
            self.repairs = ("the file is empty; if it has held rows, they are gone and their cells run again.",)
        reading = _peek(self._file)
        if reading is None or reading.whole:
            return _prepared(self._file)
        return self._rescue(reading)

    def _rescue(self, reading: Reading) -> sqlite3.Connection:
        """Write the undamaged rows to a new file and, once complete, put it in the place of the damaged file, which is
        renamed.
        """
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S%f")
        fresh = self._file.with_name(f"{self._file.name}.rescue-{stamp}")
        try:
            with closing(_prepared(fresh)) as connection, connection:
                for identity, row in reading.sound:
                    texts = texts_of(row, identity)
                    connection.execute(INSERT, (*texts, hash_of(texts)))
            aside = self._file.with_name(f"{self._file.name}.damaged-{stamp}")
            journal = self._file.with_name(f"{self._file.name}-journal")
            if journal.exists():
                journal.rename(aside.with_name(f"{aside.name}-journal"))
            try:
                aside.hardlink_to(self._file)  # so that at every moment there is a file of the store's name
            except OSError:  # a file system without links
                self._file.rename(aside)
            fresh.replace(self._file)
        except (sqlite3.Error, OSError, ProblemError) as error:
            with suppress(OSError):
                fresh.unlink(missing_ok=True)
            raise ProblemError(
                f"{self.path} is damaged and its {len(reading.sound)} sound rows cannot be saved: {error}"
            ) from error
        self.repairs = (
            f"the file was damaged; {len(reading.sound)} sound rows were saved from it, it is kept as {aside.name}.",
            f"{reading.losses}; the cells that are missing run again.",
        )
        return _connect(self._file)


def load_rows(path: str | Path) -> list[RunRow]:
    """Return the undamaged rows of a store, in the order in which their cells first came in.

    Nothing is written except the roll-back of a killed runner's transaction.  Damaged rows are left out, with a warning
    that names them.

    Raises
    ------
    ProblemError
        There is no such file, or it is no store of this version.
    """
    rows, losses = sound_rows(path)
    if losses:
        warnings.warn(losses, stacklevel=2)
    return rows


def sound_rows(path: str | Path) -> tuple[list[RunRow], str]:
    """Return the rows as :func:`load_rows`, and a sentence on what could not be read, "" if all could."""
    reading = read_store(path)
    return [row for _, row in reading.sound], reading.warning(path)


def read_store(path: str | Path) -> Reading:
    """Read a store as :func:`load_rows`, with a description of its damage.

    Raises
    ------
    ProblemError
        There is no such file, or it is no store of this version.
    """
    file = store_file(path)
    if not file.is_file():
        raise ProblemError(f"there is no store {path}.")
    reading = _peek(file)
    if reading is None:
        raise ProblemError(f"{path} cannot be read as a store: it is empty.")
    return reading


def _peek(path: Path) -> Reading | None:
    """Read a file without changing it; None if it does not exist or is empty.

    Raises
    ------
    ProblemError
        It is no store, one of another version, or cannot be opened.
    """
    if not path.exists():
        return None
    try:
        if path.with_name(f"{path.name}-journal").exists():
            _refuse_another_kind(path, begun=True)
            _connect_existing(path).close()  # undoes what was begun
        if path.stat().st_size == 0:
            return None
        _refuse_another_kind(path)
        with closing(_connect_existing(path)) as connection:
            refuse_other_version(connection, path)
            tables = _tables(connection)
            if tables is not None and tables - {"runs", "meta"}:
                foreign = min(tables - {"runs", "meta"})
                raise ProblemError(f"{path} is no store: it has a table {foreign}; name another file.")
            return None if tables == set() else read(connection)
    except sqlite3.Error as error:
        raise ProblemError(f"the store {path} cannot be opened: {error}.") from error


def _refuse_another_kind(path: Path, *, begun: bool = False) -> None:
    """Raise if the file does not start like an SQLite database; one just begun may have no header yet."""
    with path.open("rb") as file:
        start = file.read(len(HEADER))
    if begun and not any(start):
        return
    if sum(a == b for a, b in zip(start, HEADER, strict=False)) < len(HEADER) // 2:
        raise ProblemError(f"{path} is no store but another kind of file; name another.")


def _tables(connection: sqlite3.Connection) -> set[str] | None:
    """Return the names of all tables; None if they cannot be read."""
    try:
        return {shown(name) for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    except ERRORS as error:
        damage(error)
        return None


def _connect_existing(path: Path) -> sqlite3.Connection:
    """Open an existing file for reading; writable if possible, so that SQLite can roll back a killed runner's work."""
    uri = path.resolve().as_uri()
    connection = sqlite3.connect(f"{uri}?mode=rw", uri=True, timeout=30.0)
    connection.text_factory = bytes  # a damaged text need not be UTF-8
    try:
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.OperationalError:
        connection.close()
        connection = sqlite3.connect(f"{uri}?mode=ro", uri=True, timeout=30.0)
        connection.text_factory = bytes
    except ERRORS:  # it is damaged: reading tells how
        pass
    return connection


def _connect(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, timeout=30.0)  # waits for a reader; a second writer is kept out by the lock
    connection.text_factory = bytes
    connection.execute("PRAGMA journal_mode = DELETE")
    connection.execute("PRAGMA synchronous = EXTRA")
    return connection


def _prepared(path: Path) -> sqlite3.Connection:
    """Return a connection to a file in which the tables exist."""
    try:
        connection = _connect(path)
        with connection:
            connection.execute("BEGIN IMMEDIATE")
            for statement in SCHEMA:
                connection.execute(statement)
            connection.execute("INSERT OR IGNORE INTO meta VALUES ('version', ?)", (str(VERSION),))
    except sqlite3.Error as error:
        raise ProblemError(f"the store {path} cannot be opened: {error}.") from error
    return connection
