"""Facts about the machine and the libraries that a timing depends on."""

from __future__ import annotations

import os
import platform
import sqlite3
import subprocess
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from hhtbench.protocol.evidence import environment

CLOCK = ("machine", "system", "processor", "cores", "memory_GiB")  #: entries of the environment that times depend on
SOLVER_LIBRARIES = ("scikit-sundae", "diffrax")
GIT_SECONDS = 20.0  # after which the commit is unknown


@cache
def machine_facts() -> dict[str, Any]:
    """Return ``environment`` of a row: versions of libraries, commit and the machine's properties."""
    facts: dict[str, Any] = {k: v for k, v in environment().items() if k != "date"}
    for library in SOLVER_LIBRARIES:
        try:
            facts[library] = version(library)
        except PackageNotFoundError:
            facts[library] = "not installed"
    return {
        **facts,
        "commit": _commit(),
        "sqlite": sqlite3.sqlite_version,
        "processor": _processor(),
        "cores": usable_cores(),
        "memory_GiB": round(total_memory() / 2**30, 1),
    }


def clock_of(environment: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of an environment that times depend on; times of different machines do not compare."""
    return {name: environment.get(name) for name in CLOCK}


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def total_memory() -> int:
    """Return the machine's memory [bytes]."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _commit() -> str:
    """Return the git commit of this file's tree, with "-dirty" if changed; "unknown" outside a repository."""
    folder, name = os.path.split(__file__)
    git = ["git", "-C", folder]
    try:
        subprocess.run([*git, "ls-files", "--error-unmatch", name], check=True, capture_output=True, timeout=GIT_SECONDS)
        found = subprocess.run(
            [*git, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"],
            check=True,
            capture_output=True,
            text=True,
            timeout=GIT_SECONDS,
        )
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return found.stdout.strip()


def _processor() -> str:
    """Return the processor's model name from /proc/cpuinfo, else what Python knows."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
