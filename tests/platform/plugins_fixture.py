"""Distributions made on the spot: a folder with a dist-info, as pip would leave it."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Mapping
from pathlib import Path

PROBLEM = """\
    '''A weight that falls.

    More text.
    '''
    from hhtbench.protocol.problem import Problem
    from hhtbench.protocol.system import System

    class Fall(System):
        def force(self, t, q, v):
            return 0 * q  # it floats: the solver below stands still

    def problem(height=1.0, *, n=1):
        return Problem(name="fall", system=Fall(), t_span=(0.0, 1.0), q0=[height] * n, v0=[0.0] * n)

    finished = problem()
    nonsense = 3
    def makes_nonsense(k=1):
        return k
    def breaks_inside(k=1):
        return len(k)
"""

SOLVER = """\
    import numpy as np
    from hhtbench.solution.result import Solution, Status

    class Still:
        name = "still"

        def __init__(self, alpha=0.0):
            self.alpha = alpha

        def accepts(self, problem, request):
            return None if request.fixed else "it takes given steps only; give step=h"

        def solve(self, problem, request):
            n = problem.q0.size
            status = Status.newton_failed if self.alpha < 0 else Status.success
            return Solution(
                t=np.array(problem.t_span), q=np.stack([problem.q0] * 2), v=np.stack([problem.v0] * 2),
                lam=np.empty((2, 0)), mu=np.empty((2, 0)), status=status, message="stood still",
            )
"""


def make_distribution(
    folder: Path, name: str, files: Mapping[str, str], entry_points: Mapping[str, Mapping[str, str]]
) -> Path:
    """Write modules and their registration; the folder must be put on ``sys.path`` by the test."""
    for path, text in files.items():
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(textwrap.dedent(text), encoding="utf-8")
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", encoding="utf-8")
    lines = []
    for group, entries in entry_points.items():
        lines += [f"[{group}]", *(f"{key} = {value}" for key, value in entries.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def forget(*prefixes: str) -> None:
    """Drop modules that a test imported."""
    for module in list(sys.modules):
        if module.partition(".")[0] in prefixes:
            del sys.modules[module]
