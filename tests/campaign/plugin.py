"""A distribution from outside: a falling weight without JAX, and a solver that misbehaves as it is told."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from hhtbench.campaign import Campaign, Cell, plan_pairs
from hhtbench.campaign.store import RunRow, load_rows
from hhtbench.protocol.errors import ProblemError

PROBLEM = """\
    '''A weight that falls: y = 1 - g t^2 / 2.'''
    import numpy as np
    from hhtbench.protocol.problem import Motion, Problem
    from hhtbench.protocol.system import NumpySystem
    from outside import shared

    DATA = "fall.json"

    def exact(t):
        return Motion(np.array([1 - shared.G * t**2 / 2]), np.array([-shared.G * t]), np.zeros(0), np.zeros(0))

    def problem(t_end=1.0):
        system = NumpySystem(force=lambda t, q, v: 0 * q - shared.G, energy=lambda t, q, v: v[0] ** 2 / 2 + shared.G * q[0])
        return Problem(name="fall", system=system, t_span=(0.0, t_end), q0=[1.0], v0=[0.0], exact=exact)
"""

SHARED = """\
    G = 9.81
"""

SOLVER = """\
    '''Gives the exact fall with an error of rtol, or does what its option says.'''
    import ctypes
    import os
    import resource
    import signal
    import time
    import numpy as np
    from hhtbench import Counters, Solution, Status

    HOARD = []

    class Told:
        name = "told"

        def __init__(self, does="good", seconds=0.0, log=None, mark=None):
            self.does, self.seconds, self.log, self.mark = does, seconds, log, mark

        def accepts(self, problem, request):
            return "it never takes anything" if self.does == "decline" else None

        def warm_up(self, problem, request):
            pass

        def solve(self, problem, request):
            if self.log:
                with open(self.log, "a") as file:
                    file.write(f"{os.getpid()}\\n")
            time.sleep(self.seconds)
            at_worst = request.rtol is not None and request.rtol < 1e-5  # misbehaves at the tightest tolerance only
            if at_worst:
                self.misbehave()
            t = request.t_eval if request.t_eval is not None else np.linspace(*problem.t_span, 5)
            rows = [problem.exact(float(time)) for time in t]
            q, v = np.array([row.q for row in rows]), np.array([row.v for row in rows])
            q = q + (request.rtol or 0.0)
            if at_worst and self.does == "nan":
                q[-1] = np.nan
            if at_worst and self.does in ("inf", "huge"):
                q[-1] = np.inf if self.does == "inf" else 1e308
            if at_worst and self.does == "empty":
                t, q, v = t[:0], q[:0], v[:0]
            if at_worst and self.does == "short":
                t, q, v = t[:-1], q[:-1], v[:-1]
            none = np.zeros((t.size, 0))
            return Solution(t=t, q=q, v=v, lam=none, mu=none, status=Status.success, message="there",
                            counters=Counters(steps_accepted=4, residual_evaluations=8))

        def misbehave(self):
            if self.does == "killed once" and not os.path.exists(self.mark):
                open(self.mark, "w").close()
                os.kill(os.getpid(), signal.SIGKILL)
            if self.does == "killed":
                os.kill(os.getpid(), signal.SIGKILL)
            if self.does == "abort unless marked" and not os.path.exists(self.mark):
                os.abort()
            if self.does == "spoil":  # what it leaves behind hurts later tasks of the process
                os.environ["SPOILT"] = "1"
            if self.does == "fragile" and "SPOILT" in os.environ:
                os.abort()
            if self.does == "leak" and not hasattr(self, "open"):
                most = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
                self.open = [os.open(os.devnull, os.O_RDONLY) for _ in range(most - 30)]
            if self.does == "files":
                for file in [open(os.devnull) for _ in range(40)]:
                    file.close()
            if self.does == "flood":
                for _ in range(256):
                    for stream in (1, 2):
                        os.write(stream, b"on and on " * 400_000)
            if self.does == "hoard":
                for _ in range(50):
                    HOARD.append(np.ones(1_000_000))
            if self.does == "segv":
                ctypes.string_at(0)
            if self.does == "exit":
                os._exit(7)
            if self.does == "raise":
                raise self.unpicklable("no more")
            if self.does == "interrupt":
                raise KeyboardInterrupt("by the plugin")
            if self.does == "memory_error":
                raise MemoryError("none left")
            if self.does == "hang":
                ctypes.CDLL(None).pause()
            if self.does == "eat":
                self.kept = []
                while True:
                    self.kept.append(np.ones(4_000_000))
            if self.does == "fork":
                if os.fork() == 0:
                    time.sleep(60)
                os._exit(0)

        @property
        def unpicklable(self):
            class Local(Exception):
                def __reduce__(self):
                    raise TypeError("cannot be pickled")
            return Local
"""

FILES = {
    "outside/__init__.py": "",
    "outside/fall.py": PROBLEM,
    "outside/fall.json": "{}",
    "outside/other.json": "{}",
    "outside/other.py": "VALUE = 1\n",
    "outside/shared.py": SHARED,
    "outside/told.py": SOLVER,
}
GROUPS = {
    "hhtbench.problems": {"fall": "outside.fall:problem"},
    "hhtbench.solvers": {"told": "outside.told:Told", "absent": "outside.told:Absent"},
}


def first_cells(campaign: Campaign) -> list[Cell]:
    """What every pair of a campaign asks for first: all of it, where its settings are given."""
    return [cell for pair in plan_pairs(campaign) for cell in pair.next_cells(())]


def started(folder: Path, *words: str) -> subprocess.Popen[str]:
    """The command ``hhtbench``, which finds the distribution in ``folder``."""
    environment, main = {**os.environ, "PYTHONPATH": str(folder)}, "from hhtbench.cli.main import main; main()"
    command = [sys.executable, "-c", main, *words]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for(what: Callable[[], bool], seconds: float = 60.0) -> None:
    """Until ``what`` holds; it fails where that takes longer."""
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end
        time.sleep(0.02)


def alive(pid: int) -> bool:
    """Whether there is such a process that has not ended."""
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


def rows_so_far(store: Path) -> list[RunRow]:
    """Of a store that may not be there yet."""
    try:
        return load_rows(store)
    except ProblemError:
        return []
