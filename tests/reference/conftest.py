"""A falling mass and solvers that err as they are told, in a file of their own: certification without integration."""

from __future__ import annotations

from pathlib import Path

import pytest

from hhtbench.campaign.reference.plan import Entry

SCENE = '''
import numpy as np
from dataclasses import dataclass
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System
from hhtbench.solution.result import Solution, Status


class Fall(System):
    def force(self, t, q, v):
        return 0 * q - 10.0


def height(t, q, v, lam):
    return q[0]


def exact(t):
    return Motion(np.array([1.0 - 5.0 * t**2]), np.array([-10.0 * t]), np.zeros(0), np.zeros(0))


def fall(known=False, t_end=1.0):
    return Problem(
        name="fall", system=Fall(), t_span=(0.0, t_end), q0=[1.0], v0=[0.0], scales=Scales(q=2.0, v=10.0),
        observables={"height": height}, exact=exact if known else None,
    )


@dataclass(frozen=True)
class Told:
    """The fall with ``error`` at every time but the start's, ``late`` at the end only, ``gain`` times a moved start."""

    method: str = "A"
    form: str = "ggl"
    error: float = 0.0
    late: float = 0.0
    gain: float = 0.0
    fails: bool = False
    name: str = "told"

    def accepts(self, problem, request):
        return None

    def solve(self, problem, request):
        t = np.asarray(request.t_eval)
        if self.fails:
            t = t[:1]
        off = self.error * (t > 0) + self.late * (t == problem.t_span[1]) + self.gain * (problem.q0[0] - 1.0)
        none = np.zeros((t.size, 0))
        status = Status.newton_failed if self.fails else Status.success
        q, v = np.array([exact(s)[0] for s in t]), np.array([exact(s)[1] for s in t])
        return Solution(t=t, q=q + off[:, None], v=v, lam=none, mu=none, status=status, message="as told")
'''


@pytest.fixture
def scene(tmp_path: Path) -> str:
    """The file, for specs such as ``{scene}:fall``."""
    file = tmp_path / "scene.py"
    file.write_text(SCENE, encoding="utf-8")
    return str(file)


@pytest.fixture
def planned(scene: str):
    """planned(second, ...) -> Entry of the fall at 0.5 and 1 s; solvers by the arguments of ``Told``."""

    def make(*second: str, first: str = "", problem: str = "fall", **more) -> Entry:
        solvers = tuple(f"{scene}:Told({arguments})" for arguments in second)
        options = {"name": "fall", "times": (0.5, 1.0), "grid": 0, **more}
        return Entry(spec=f"{scene}:{problem}", first=f"{scene}:Told({first})", second=solvers, **options)

    return make
