"""Files of machine code, by name; a folder that cannot be written and a damaged file are as good as none."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from pathlib import Path

from hhtbench.lowering.caching import cache_directory

CHECKSUM = hashlib.sha256().digest_size


def folder() -> Path:
    """Where they are."""
    return cache_directory() / "native"


def read_file(name: str) -> bytes | None:
    """The bytes kept under a name."""
    try:
        return (folder() / name).read_bytes()
    except OSError:
        return None


def write_file(name: str, data: bytes) -> None:
    """Keep ``data`` under a name: written beside it first, so that no reader ever sees half a file."""
    temporary = None
    try:
        folder().mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=folder(), prefix=".")
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        os.replace(temporary, folder() / name)
    except OSError:
        if temporary is not None:
            with contextlib.suppress(OSError):
                os.unlink(temporary)


def sealed(body: bytes) -> bytes:
    """``body`` behind its checksum."""
    return hashlib.sha256(body).digest() + body


def unsealed(data: bytes | None) -> bytes | None:
    """What was sealed; None where there is nothing or it is damaged."""
    if data is None or hashlib.sha256(data[CHECKSUM:]).digest() != data[:CHECKSUM]:
        return None
    return data[CHECKSUM:]
