"""Files of machine code, by name; a folder that cannot be written and a damaged file are as good as none."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile

from hhtbench.lowering.caching import private_folder

CHECKSUM = hashlib.sha256().digest_size


def read_file(name: str) -> bytes | None:
    """What is kept under a name; None where there is nothing or its checksum does not match."""
    folder = private_folder("native")
    if folder is None:
        return None
    try:
        data = (folder / name).read_bytes()
    except OSError:
        return None
    return data[CHECKSUM:] if hashlib.sha256(data[CHECKSUM:]).digest() == data[:CHECKSUM] else None


def write_file(name: str, body: bytes) -> None:
    """Keep ``body`` under a name, behind its checksum: written beside it first, so that no reader ever sees half a file."""
    folder, temporary = private_folder("native"), None
    if folder is None:
        return
    try:
        handle, temporary = tempfile.mkstemp(dir=folder, prefix=".")
        with os.fdopen(handle, "wb") as file:
            file.write(hashlib.sha256(body).digest() + body)
        os.replace(temporary, folder / name)
    except OSError:
        if temporary is not None:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
