"""Whether the user's functions read files while they are traced: what they read may change, and no name would tell."""

from __future__ import annotations

import sys
import sysconfig
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax

from hhtbench.lowering.caching import cache_directory

CODE = (".py", ".pyc", ".pyi", ".so", ".pyd", ".dll", ".dylib")  # what an import opens
NOBODYS = ("/sys/", "/proc/", "/dev/", *(sysconfig.get_paths()[key] for key in ("stdlib", "purelib", "platlib")))
_local = threading.local()
_hooked: list[bool] = []
_lock = threading.Lock()


@contextmanager
def files_read() -> Iterator[list[str]]:
    """A list to which the files are added that this thread opens in the meantime, but for code, libraries and our caches."""
    with _lock:
        if not _hooked:
            sys.addaudithook(_hook)  # for the life of the process: hooks cannot be taken away
            _hooked.append(True)
    before = getattr(_local, "opened", None)
    opened: list[str] = []
    _local.opened = opened
    try:
        yield opened
    finally:
        _local.opened = before
        if before is not None:
            before += opened


def _hook(event: str, arguments: Any) -> None:
    if event != "open":
        return
    opened = getattr(_local, "opened", None)
    if opened is None or not isinstance(arguments[0], str | bytes | Path):
        return
    path = str(arguments[0]) if not isinstance(arguments[0], bytes) else arguments[0].decode(errors="replace")
    caches = str(cache_directory()), str(getattr(jax.config, "jax_compilation_cache_dir", None) or cache_directory())
    if not path.endswith(CODE) and not path.startswith((*caches, *NOBODYS)):
        opened.append(path)
