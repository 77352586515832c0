"""Peak memory of a process before and after many steps with one row of output, printed as JSON [MB].

``python -m tests.performance.engine.long_run [STEPS]``; run by :mod:`tests.performance.engine.limits`.
"""

from __future__ import annotations

import json
import resource
import sys
from pathlib import Path

from problems import jay_negrut_pendulum
from tests.performance.engine.ours import constant_steps

STEPS, FEW, H = 10_000_000, 1000, 1e-3
STATUS = Path("/proc/self/status")  # of Linux
UNIT = 2**20 if sys.platform == "darwin" else 2**10  # of ru_maxrss, in one MB


def peak() -> float:
    """Of this process so far [MB].

    ``ru_maxrss`` begins with the size of the process that started this one: below it nothing would be seen.
    """
    if STATUS.is_file():
        line = next(line for line in STATUS.read_text(encoding="ascii").splitlines() if line.startswith("VmHWM:"))
        return int(line.split()[1]) / 2**10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / UNIT


def main(steps: int) -> None:
    """One line of JSON."""
    problem = jay_negrut_pendulum.problem(c=0.0, t_end=steps * H)
    constant_steps(problem, H, FEW, alpha=-0.3)
    before = peak()
    constant_steps(problem, H, steps, alpha=-0.3)
    sys.stdout.write(json.dumps({"before": before, "after": peak()}) + "\n")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else STEPS)
