"""Times of a process of its own, printed as JSON: imports, the first solve of one step, the same again.

``python -m tests.performance.engine.probe pendulum|andrews``; run by :mod:`tests.performance.engine.compiling`.
"""

from __future__ import annotations

import sys
import time

started = time.process_time()

import json  # noqa: E402 - the imports are timed
from collections.abc import Callable  # noqa: E402

from problems import andrews, jay_negrut_pendulum  # noqa: E402
from tests.performance.engine.ours import constant_steps  # noqa: E402

imported = time.process_time()

SCENES: dict[str, tuple[Callable[[], object], float]] = {
    "pendulum": (jay_negrut_pendulum.problem, 1e-3),
    "andrews": (andrews.problem, 0.03 / 12_000),
}


def main(name: str) -> None:
    """One line of JSON: seconds of processor time."""
    make, h = SCENES[name]
    problem = make()
    times = []
    for _ in range(2):
        begun = time.process_time()
        constant_steps(problem, h, 1, alpha=-0.3)  # type: ignore[arg-type]
        times.append(time.process_time() - begun)
    sys.stdout.write(json.dumps({"imports": imported - started, "first": times[0], "second": times[1]}) + "\n")


if __name__ == "__main__":
    main(sys.argv[1])
