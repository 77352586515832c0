"""The one place that says where compiled code is kept."""

from __future__ import annotations

import os
from pathlib import Path

import jax


def cache_directory() -> Path:
    """Where compiled code is kept: ``$HHTBENCH_CACHE``, else ``$XDG_CACHE_HOME/hhtbench``, else ``~/.cache/hhtbench``."""
    base = os.environ.get("HHTBENCH_CACHE")
    if base:
        return Path(base)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hhtbench"


def use_disk_cache() -> None:
    """Point JAX's persistent cache to our folder unless the user has chosen one."""
    if getattr(jax.config, "jax_compilation_cache_dir", None) is None:
        jax.config.update("jax_compilation_cache_dir", str(cache_directory() / "xla"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
