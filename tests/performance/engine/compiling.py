"""How long a system takes to become machine code, in processes of their own.

``python -m tests.performance.engine.compiling pendulum|andrews`` is such a process: it prints seconds of processor time.
"""

from __future__ import annotations

import time

started = time.process_time()

import json  # noqa: E402 - the imports are timed
import os  # noqa: E402
import statistics  # noqa: E402
import subprocess  # noqa: E402
import sys  # noqa: E402
import tempfile  # noqa: E402
from concurrent.futures import ThreadPoolExecutor  # noqa: E402
from dataclasses import asdict  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

from problems import andrews, jay_negrut_pendulum  # noqa: E402
from tests.performance.engine.clock import estimate, unmeasured  # noqa: E402
from tests.performance.engine.ours import constant_steps  # noqa: E402

imported = time.process_time()

SCENES: dict[str, tuple[Any, float]] = {
    "pendulum": (jay_negrut_pendulum.problem, 1e-3),
    "andrews": (andrews.problem, 0.03 / 12_000),
}
LIMITS = {  # by cache: an empty one, or its own, of which the code is taken and the system traced again [s]
    "an empty cache": {"pendulum": 3.0, "andrews": 10.0},
    "its own cache": {"pendulum": 1.2, "andrews": 1.6},
}
ROUNDS = 6  # the fewest whose range holds the median at 95 %
PATIENCE = 300.0  # of one process [s]


def measure_compiling() -> list[dict[str, Any]]:
    """A line a scene and cache; both scenes at a time."""
    with ThreadPoolExecutor(len(SCENES)) as pool:
        times = [dict(zip(SCENES, pool.map(_round, SCENES), strict=True)) for _ in range(ROUNDS)]
    return [_line(name, cache, [found[name][cache] for found in times]) for name in SCENES for cache in LIMITS]


def _round(name: str) -> dict[str, dict[str, float] | str]:
    with tempfile.TemporaryDirectory() as folder:
        return {cache: _probe(name, Path(folder)) for cache in LIMITS}


def _line(name: str, cache: str, times: list[dict[str, float] | str]) -> dict[str, Any]:
    line, limit = {"what": f"{name}, {cache}", "unit": "s"}, LIMITS[cache][name]
    good = [found for found in times if not isinstance(found, str)]
    failed = [found for found in times if isinstance(found, str)]
    if failed:
        return {**line, **unmeasured(limit, failed[0])}
    found = estimate([one["first"] - one["second"] for one in good], (ROUNDS,))
    imports, solve = (statistics.median(one[key] for one in good) for key in ("imports", "second"))
    note = f"imports {imports:.2g} s, the solve itself {1e3 * solve:.2g} ms"
    return {**line, **asdict(found), "limit": limit, "verdict": found.verdict(limit), "note": note}


def _probe(name: str, cache: Path) -> dict[str, float] | str:
    """Times of one process with ``cache`` as its only cache; or why there are none."""
    own = {"HHTBENCH_CACHE": str(cache), "JAX_COMPILATION_CACHE_DIR": str(cache / "xla")}
    command = [sys.executable, "-m", "tests.performance.engine.compiling", name]
    try:
        done = subprocess.run(
            command, env={**os.environ, **own}, capture_output=True, text=True, check=False, timeout=PATIENCE
        )
    except subprocess.TimeoutExpired:
        return f"{name} took more than {PATIENCE:.0f} s"
    if done.returncode:
        return f"{name} failed: {(done.stderr.strip() or 'no message').splitlines()[-1][:200]}"
    return dict(json.loads(done.stdout.splitlines()[-1]))


def main(name: str) -> None:
    """Times of this process: imports, the first solve of one step, the same again."""
    make, h = SCENES[name]
    problem, times = make(), []
    for _ in range(2):
        begun = time.process_time()
        constant_steps(problem, h, 1, alpha=-0.3)
        times.append(time.process_time() - begun)
    sys.stdout.write(json.dumps({"imports": imported - started, "first": times[0], "second": times[1]}) + "\n")


if __name__ == "__main__":
    main(sys.argv[1])
