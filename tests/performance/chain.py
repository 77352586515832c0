"""Whole solves of the planar chain beside Exudyn's, the growth with the number of links, and the peak memory.

Not a test: a loaded machine may not fail a build.  ``make bench-chain``, or ``python -m tests.performance.chain [N ...]``.
Both codes take the same steps of the same chain from a system that is ready, in turn, so that both see the same machine:
``HHT.solve`` with its start and its output, Exudyn's ``SolveSystem``.  Compared is the processor time, all threads together:
on an idle core that is the time on the clock, on a shared one it is what remains comparable; the clock's ratio is printed
beside it.  Modified Newton on both sides, equal damping at infinite frequency, Exudyn with the faster of its linear solvers.
The reference of both is the certified one of 16 links, else this method with steps a sixteenth as long.  The memory is that
of one more process, which solves the longest chain and nothing else.
"""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import dataclass
from functools import partial

import numpy as np

import hhtbench  # noqa: F401 - 64 bit before anything else
from hhtbench.protocol import Problem
from hhtbench.result import Solution
from problems import planar_chain
from solvers.hht import HHT
from tests.performance.engine.clock import compare
from tests.performance.engine.long_run import peak

try:
    import exudyn
    from exudyn import itemInterface as items
except ImportError:
    exudyn = None

RHO = 0.9  # damping factor at infinite frequency, of both codes
FINER = 16  # the reference's steps in one of the compared
SAME_ERROR = 1.5  # ratio to Exudyn's error up to which ours counts as not larger: the constants of two methods differ
GROWTH, MEMORY = 1.1, 1024.0  # exponent of N; [MiB]
ALONE = "--alone"  # before a number of links: print the memory of their solve
CERTIFIED = 16  # links, the longest chain with a certified reference; 1000 steps lead to its second row
DENSE = 16  # links up to which Exudyn's dense solver may be the faster one


@dataclass(frozen=True)
class Case:
    """One size."""

    links: int
    h: float  #: [s]
    steps: int
    limit: float = math.inf  #: of our time over Exudyn's


CASES = (
    Case(1, 1e-4, 10_000, 0.15),
    Case(10, 1e-4, 2000, 0.15),
    Case(CERTIFIED, 1.25e-4, 1000),
    Case(100, 1e-4, 400, 0.4),
    Case(1000, 1e-4, 100, 0.3),
    Case(10_000, 1e-5, 30, 0.5),
)


def solved(hht: HHT, problem: Problem, h: float, steps: int) -> Solution:
    """``steps`` steps of ``h`` [s] of our chain, with output at their end."""
    end = h * steps
    return hht.solve((0.0, end), problem.q0, problem.v0, step=h, t_eval=[0.0, end])


class Theirs:
    """The same chain in Exudyn."""

    def __init__(self, links: int, h: float, steps: int) -> None:
        self.container = exudyn.SystemContainer()
        self.mbs = self.container.AddSystem()
        length = mass = 1.0 / links
        ground = self.mbs.AddObject(items.ObjectGround())
        last = self.mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=ground, localPosition=[0, 0, 0]))
        for i in range(links):
            node = self.mbs.AddNode(items.NodeRigidBody2D(referenceCoordinates=[(i + 0.5) * length, 0, 0]))
            rod = items.ObjectRigidBody2D(mass=mass, inertia=mass * length**2 / 12, nodeNumber=node)
            body = self.mbs.AddObject(rod)
            centre = self.mbs.AddMarker(items.MarkerBodyMass(bodyNumber=body))
            self.mbs.AddLoad(items.LoadMassProportional(markerNumber=centre, loadVector=[0, -9.81, 0]))
            begins, ends = (
                self.mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=body, localPosition=[x, 0, 0]))
                for x in (-length / 2, length / 2)
            )
            self.mbs.AddObject(items.RevoluteJoint2D(markerNumbers=[last, begins]))
            last = ends
        self.mbs.Assemble()
        self.settings = self._settings(h, steps)

    @staticmethod
    def _settings(h: float, steps: int) -> object:
        settings = exudyn.SimulationSettings()
        integration = settings.timeIntegration
        integration.endTime, integration.numberOfSteps = h * steps, steps
        integration.generalizedAlpha.spectralRadius = RHO
        integration.newton.useModifiedNewton = True
        integration.adaptiveStep = False
        settings.linearSolver.solverType = exudyn.LinearSolverType.EigenSparse
        settings.solution.file.write = False
        settings.parallel.numberOfThreads = 1
        return settings

    def solve(self, solver: str) -> None:
        """All steps from the start, with the linear solver of that name; nothing is written, nobody is called in between."""
        self.settings.linearSolver.solverType = getattr(exudyn.LinearSolverType, solver)  # type: ignore[attr-defined]
        if not exudyn.MainSolverImplicitSecondOrder().SolveSystem(self.mbs, self.settings):
            raise SystemExit("Exudyn did not finish")

    @property
    def q(self) -> np.ndarray:
        """(3 N,) coordinates: displacements from the start, and the start."""
        moved = np.array(self.mbs.systemData.GetODE2Coordinates())
        start = np.zeros((moved.size // 3, 3))
        start[:, 0] = (np.arange(len(start)) + 0.5) / len(start)
        return moved + start.ravel()


def measure(case: Case) -> tuple[float, float]:
    """Median processor time of one of our steps [s] and the ratio to Exudyn's; prints the line of this size."""
    problem = planar_chain.problem(n_links=case.links)
    hht = HHT(problem.system, rho_inf=RHO)
    ours = partial(solved, hht, problem, case.h, case.steps)
    actions, told, fair = {"ours": ours}, "exudyn is not installed", False
    if exudyn is not None:
        theirs = Theirs(case.links, case.h, case.steps)
        names = ("EXUdense", "EigenSparse") if case.links <= DENSE else ("EigenSparse",)
        actions |= {name: partial(theirs.solve, name) for name in names}
        reference = refined(case, hht, problem)
        theirs.solve(names[-1])
        errors = [float(np.abs(q - reference).max()) for q in (ours().q[-1], theirs.q)]
        fair = errors[0] <= SAME_ERROR * errors[1]  # a larger error would make our steps cheap
        told = f"errors {errors[0]:.1e}, {errors[1]:.1e}: {'ours is not larger' if fair else 'OURS IS LARGER'}"
    best = lambda seconds: min((seconds[name] for name in actions if name != "ours"), default=math.nan)  # noqa: E731
    found = compare(actions, lambda seconds: seconds["ours"] / best(seconds), case.limit)
    mine, other = found.cpu("ours"), best({name: found.cpu(name) for name in actions})
    ratio, verdict = found.figure.value, found.figure.verdict(case.limit) if fair else "BROKEN"
    kind = hht.engine_used.rpartition(", ")[2]
    sys.stdout.write(
        f"{case.links:6d} links  {kind:13s} ours {1e6 * mine / case.steps:8.2f} us a step  exudyn "
        f"{1e6 * other / case.steps:8.2f}  ratio {ratio:5.3f} [{found.figure.low:5.3f}, {found.figure.high:5.3f}] of "
        f"{case.limit:g} {verdict:11s} (clock {found.on_clock:5.3f})  {told}\n"
    )
    sys.stdout.flush()
    return mine / case.steps, ratio if fair else math.inf


def refined(case: Case, hht: HHT, problem: Problem) -> np.ndarray:
    """q (3 N,) at the end of ``case``: the certified value, or with steps ``FINER`` times smaller."""
    known = planar_chain.problem(n_links=case.links, t_end=1.0).reference
    if known is not None:
        rows = np.flatnonzero(np.isclose(known["t"], case.h * case.steps, rtol=1e-12, atol=0.0))
        if rows.size:
            return np.asarray(known["q"][rows[0]])
    return np.asarray(solved(hht, problem, case.h / FINER, case.steps * FINER).q[-1])


def main(sizes: list[int]) -> int:
    """Measure the sizes asked for, all of them by default; 1 if a limit breaks."""
    cases = [case for case in CASES if not sizes or case.links in sizes]
    times, broken = {}, 0
    for case in cases:
        seconds, ratio = measure(case)
        times[case.links] = seconds
        broken += ratio > case.limit
    larger = [links for links in times if links >= 100]
    if len(larger) > 1:
        first, last = min(larger), max(larger)
        growth = math.log(times[last] / times[first]) / math.log(last / first)
        sys.stdout.write(f"time per step grows like N^{growth:.2f} from {first} to {last} links (limit {GROWTH})\n")
        broken += growth > GROWTH
    links = str(max(times))
    alone = subprocess.run([sys.executable, "-m", __spec__.name, ALONE, links], capture_output=True, text=True, check=True)
    memory = float(alone.stdout)
    sys.stdout.write(f"peak memory of a process that solves {links} links {memory:.0f} MiB (limit {MEMORY:.0f})\n")
    return 1 if broken or memory > MEMORY else 0


def memory_of(links: int) -> float:
    """Peak memory [MiB] of this process after a solve, without Exudyn's and without a finer reference."""
    case = next(case for case in CASES if case.links == links)
    problem = planar_chain.problem(n_links=links)
    solved(HHT(problem.system, rho_inf=RHO), problem, case.h, case.steps)
    return peak()


if __name__ == "__main__":
    if sys.argv[1:2] == [ALONE]:
        sys.stdout.write(f"{memory_of(int(sys.argv[2]))}")
    else:
        sys.exit(main([int(size) for size in sys.argv[1:]]))
