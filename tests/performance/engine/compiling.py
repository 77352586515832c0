"""Section 2: how long a system takes to become machine code, in processes of their own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from tests.performance.engine.ours import ENGINE

LIMITS = {"pendulum": 3.0, "andrews": 10.0}  # with an empty cache [s]
CACHED = {"pendulum": 1.2, "andrews": 1.6}  # traced again, the code from the disk cache [s]
PATIENCE = 300.0  # of one process [s]


def measure_compiling() -> list[dict[str, Any]]:
    """One line a scene: an empty cache, and a cache filled by itself."""
    lines = []
    for name in LIMITS:
        with tempfile.TemporaryDirectory() as folder:
            lines.append(_line(name, {kind: _probe(name, Path(folder)) for kind in ("empty", "own")}))
    return lines


def _line(name: str, times: dict[str, dict[str, float] | str]) -> dict[str, Any]:
    failed = [value for value in times.values() if isinstance(value, str)]
    line: dict[str, Any] = {
        "scene": name,
        "limit": LIMITS[name],
        "cached_limit": CACHED[name],
        "note": "; ".join(dict.fromkeys(failed)),
    }
    if failed:
        return {**line, **dict.fromkeys(("imports_s", "empty_s", "cached_s", "solve_s", "holds"))}
    cost = {kind: t["first"] - t["second"] for kind, t in times.items() if not isinstance(t, str)}
    own = times["own"]
    assert not isinstance(own, str)
    return {
        **line,
        "imports_s": own["imports"],
        "empty_s": cost["empty"],
        "cached_s": cost["own"],
        "solve_s": own["second"],
        "holds": bool(cost["empty"] <= LIMITS[name] and cost["own"] <= CACHED[name]),
    }


def _probe(name: str, cache: Path) -> dict[str, float] | str:
    """Times of one process with ``cache`` as its only cache; or why there are none."""
    own = {
        "HHTBENCH_CACHE": str(cache),
        "JAX_COMPILATION_CACHE_DIR": str(cache / "xla"),
    }
    command = [sys.executable, "-m", "tests.performance.engine.probe", name]
    try:
        done = subprocess.run(
            command, env={**os.environ, **own}, capture_output=True, text=True, check=False, timeout=PATIENCE
        )
    except subprocess.TimeoutExpired:
        return f"{name} ({ENGINE}) took more than {PATIENCE:.0f} s"
    if done.returncode:
        return f"{name} ({ENGINE}) failed: {(done.stderr.strip() or 'no message').splitlines()[-1][:200]}"
    return dict(json.loads(done.stdout.splitlines()[-1]))
