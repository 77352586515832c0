"""The file of a store and its lock file, before SQLite opens either."""

from __future__ import annotations

import fcntl
import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

from hhtbench.protocol.errors import ProblemError


def store_file(path: Any) -> Path:
    """Check ``path`` as that of a store's file, which need not exist, and return it.

    Raises
    ------
    TypeError, ProblemError
        It is no path, or cannot be that of a file.
    """
    if not isinstance(path, (str, Path)):
        raise TypeError(f"a store is named by the path of its file; got {type(path).__name__}.")
    if not str(path) or "\0" in str(path):
        raise ProblemError(f"a store needs the name of a file, such as runs.sqlite; got {str(path)!r}.")
    file = Path(path)
    try:
        if file.exists() and not file.is_file():
            kind = f"a folder; name a file in it, such as {file / 'runs.sqlite'}" if file.is_dir() else "no plain file"
            raise ProblemError(f"{path} cannot be a store: it is {kind}.")
        file.resolve()
    except OSError as error:
        raise ProblemError(f"{path} cannot be a store: {error.strerror}.") from error
    except RuntimeError as error:  # so Python tells links that go round in a circle
        raise ProblemError(f"{path} cannot be a store: {error}.") from error
    return file


def take_lock(path: Path) -> Any:
    """Return ``<store>.lock``, open and locked exclusively until it is closed or this process ends, however it ends.

    ``path`` is the file itself, not a link to it: else two runners through two names would both write.
    """
    file = path.with_name(f"{path.name}.lock")
    try:
        file.touch()
        lock = file.open("r+b", buffering=0)  # what the last runner has left in it stays
    except OSError as error:
        raise ProblemError(f"{path.parent} cannot be written: {error.strerror}.") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        lock.close()
        raise ProblemError(f"another `hhtbench run` writes {path}; wait for it, or use another store.") from error
    return lock


def leave_count(lock: Any, database: Any) -> None:
    """Write the database's count of changes into the lock file; an older copy of the database has a smaller count."""
    with suppress(OSError):  # what is counted is on the disk
        os.pwrite(lock.fileno(), b"changes %10d\n" % count_of_changes(database), 0)


def left_count(lock: Any) -> int:
    """Return the count of changes that the last runner left in the lock file; 0 if none."""
    found = re.match(rb"changes +(\d+)\n", os.pread(lock.fileno(), 64, 0))
    return int(found[1]) if found else 0


def count_of_changes(database: Any) -> int:
    """Return SQLite's own count of the transactions that changed an open file (sqlite.org/fileformat2.html, 1.3.7)."""
    return int.from_bytes(os.pread(database.fileno(), 4, 24), "big")
