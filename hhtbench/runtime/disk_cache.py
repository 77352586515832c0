"""Compiled code on disk, in a folder that only its owner can write."""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

CHECKSUM = hashlib.sha256().digest_size


def private_folder(name: str) -> Path | None:
    """The folder ``name`` of the cache, which only its owner can write; None if there is none to be trusted.

    The cache: ``$HHTBENCH_CACHE``, else ``$XDG_CACHE_HOME/hhtbench``, else ``~/.cache/hhtbench``.
    Its files are loaded and run, so the folder is protected by owner and mode.  It is made with mode 0700; one that
    belongs to somebody else or that others can write is refused with a warning, and nothing is kept.
    """
    given = os.environ.get
    base = Path(given("HHTBENCH_CACHE") or Path(given("XDG_CACHE_HOME") or Path.home() / ".cache") / "hhtbench")
    try:
        for folder in (base, base / name):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            reason = _foreign_access(folder)
            if reason:
                warnings.warn(f"compiled code is not kept: the folder {folder} {reason}.", UserWarning, stacklevel=3)
                return None
    except OSError:
        return None
    return base / name


def _foreign_access(folder: Path) -> str:
    """Sentence on why others could have put code into ``folder``; empty if they could not."""
    if not hasattr(os, "geteuid"):  # without POSIX modes a user's folders are private by other means
        return ""
    found, remedy = folder.stat(), "set HHTBENCH_CACHE to a folder of your own"
    if found.st_uid != os.geteuid():
        return f"belongs to user {found.st_uid}, not to you; {remedy}"
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"can be written by others; run chmod go-w on it once you trust what is in it, or {remedy}"
    return ""


def kept_on_disk(content: bytes, kind: str, make: Callable[[], bytes]) -> bytes:
    """Machine code for ``content``, read from disk or made by ``make()`` and stored.

    The key is a hash of the full ``content``, as nothing less identifies code.  If the folder cannot be written, or a file's
    checksum does not match, the code is made again.
    """
    folder = private_folder("native")
    if folder is None:
        return make()
    file = folder / f"{hashlib.sha256(content).hexdigest()}.{kind}"
    with contextlib.suppress(OSError):
        data = file.read_bytes()
        if hashlib.sha256(data[CHECKSUM:]).digest() == data[:CHECKSUM]:
            return data[CHECKSUM:]
    body = make()
    with contextlib.suppress(OSError):
        handle, temporary = tempfile.mkstemp(dir=folder, prefix=".")  # renamed when complete: no reader sees half a file
        try:
            with os.fdopen(handle, "wb") as opened:
                opened.write(hashlib.sha256(body).digest() + body)
            os.replace(temporary, file)
        except OSError:
            os.unlink(temporary)
    return body


def use_disk_cache() -> None:
    """Set JAX's persistent cache to our folder unless the user has chosen one."""
    import jax

    if getattr(jax.config, "jax_compilation_cache_dir", None) is None and (folder := private_folder("xla")) is not None:
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
