"""Section 2: how long a system takes to become machine code, in processes of their own."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tests.performance.engine.clock import estimate, unmeasured
from tests.performance.engine.ours import ENGINE

LIMITS = {"pendulum": 3.0, "andrews": 10.0}  # with an empty cache [s]
CACHED = {"pendulum": 1.2, "andrews": 1.6}  # traced again, the code from the disk cache [s]
KINDS = {"empty": LIMITS, "own": CACHED}  # of caches
ROUNDS = 6  # the fewest whose range holds the median at 95 %
OTHERS = {"imports": "imports", "solve": "second"}  # of a probe's times
PATIENCE = 300.0  # of one process [s]


def measure_compiling() -> list[dict[str, Any]]:
    """A line a scene and cache: an empty one, and one filled by itself; both scenes at a time."""
    with ThreadPoolExecutor(len(LIMITS)) as pool:
        times = [dict(zip(LIMITS, pool.map(_round, LIMITS), strict=True)) for _ in range(ROUNDS)]
    return [_line(name, kind, [found[name][kind] for found in times]) for name in LIMITS for kind in KINDS]


def _round(name: str) -> dict[str, dict[str, float] | str]:
    with tempfile.TemporaryDirectory() as folder:
        return {kind: _probe(name, Path(folder)) for kind in KINDS}


def _line(name: str, kind: str, times: list[dict[str, float] | str]) -> dict[str, Any]:
    line, limit = {"scene": name, "cache": kind}, KINDS[kind][name]
    good = [found for found in times if not isinstance(found, str)]
    failed = [found for found in times if isinstance(found, str)]
    if failed:
        return {**line, **unmeasured(limit, failed[0]), "imports_s": None, "solve_s": None}
    found = estimate([one["first"] - one["second"] for one in good], (ROUNDS,))
    medians = {f"{what}_s": statistics.median(one[key] for one in good) for what, key in OTHERS.items()}
    return {**line, **asdict(found), "limit": limit, "verdict": found.verdict(limit), **medians, "note": ""}


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
