"""Facts about the machine and the libraries that a timing depends on."""

from __future__ import annotations

import os
import platform
import sqlite3
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from hhtbench.evidence import environment

SOLVER_LIBRARIES = ("scikit-sundae", "diffrax")


def machine_facts() -> dict[str, Any]:
    """``environment`` of a row: text and numbers."""
    facts: dict[str, Any] = {k: v for k, v in environment().items() if k != "date"}
    for library in SOLVER_LIBRARIES:
        try:
            facts[library] = version(library)
        except PackageNotFoundError:
            facts[library] = "not installed"
    return {
        **facts,
        "sqlite": sqlite3.sqlite_version,
        "processor": _processor(),
        "cores": usable_cores(),
        "memory_GiB": round(total_memory() / 2**30, 1),
    }


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def total_memory() -> int:
    """Memory of the machine [bytes]."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _processor() -> str:
    """The model as Linux names it, else what Python knows."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
