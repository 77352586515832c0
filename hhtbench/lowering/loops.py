"""Loops over numbers compiled by Numba, kept on disk by the content of all their sources.

Numba itself looks at the file of the function only: what that file's functions call in others may change unseen.
"""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba
from numba.core import config as _config

from hhtbench.lowering.compiling import cache_directory

config: Any = _config
_lock = threading.Lock()


def loops(*folders: Path, bare: bool = False, inner: bool = False, inline: bool = False) -> Callable[[Any], Any]:
    """A decorator that compiles functions made of loops over numbers, for modules whose sources lie in ``folders``.

    Parameters
    ----------
    bare
        They make no arrays, so references to arrays need not be counted, which costs more than small loops do; they may
        return a part of an array only where they are put ``inline`` into their callers.
    inner
        They are called by other such functions only, with which they are kept on disk.
    """
    options: dict[str, Any] = {"error_model": "numpy"} | ({"_nrt": False} if bare else {})
    options |= {"inline": "always"} if inline else {}
    options |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True} if inner else {}

    def compiled(function: Any) -> Any:
        if inner or inline:
            return numba.njit(**options)(function)
        with _lock:
            before = config.CACHE_DIR
            config.CACHE_DIR = str(cache_directory() / "loops" / _content(folders))
            try:
                return numba.njit(cache=True, **options)(function)
            except (RuntimeError, OSError):  # there is no folder that can be written
                return numba.njit(**options)(function)
            finally:
                config.CACHE_DIR = before

    return compiled


@lru_cache
def _content(folders: tuple[Path, ...]) -> str:
    """A name for the content of all Python sources in ``folders``."""
    digest = hashlib.sha256()
    for path in sorted(path for folder in folders for path in (folder.glob("*.py") if folder.is_dir() else [folder])):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:16]
