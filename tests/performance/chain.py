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
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

import hhtbench  # noqa: F401 - 64 bit before anything else
from hhtbench.protocol.problem import Problem
from hhtbench.solution.result import Solution
from problems import planar_chain
from solvers.hht import HHT
from tests.performance.engine.clock import BROKEN, compare, unmeasured
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


def measure(case: Case) -> dict[str, Any]:
    """Our time over Exudyn's, with the median processor time of one of our steps, ``ours_s`` [s]."""
    problem = planar_chain.problem(n_links=case.links)
    hht = HHT(problem.system, rho_inf=RHO)
    ours, line = partial(solved, hht, problem, case.h, case.steps), {"what": f"{case.links} links", "unit": ""}
    if exudyn is None:
        alone = compare({"ours": ours}, lambda seconds: seconds["ours"], math.inf).cpu("ours") / case.steps
        note = f"exudyn is not installed; {1e6 * alone:.2f} us a step"
        return {**line, **unmeasured(case.limit, note), "ours_s": alone}
    theirs = Theirs(case.links, case.h, case.steps)
    names = ("EXUdense", "EigenSparse") if case.links <= DENSE else ("EigenSparse",)
    reference = refined(case, hht, problem)
    theirs.solve(names[-1])
    errors = [float(np.abs(q - reference).max()) for q in (ours().q[-1], theirs.q)]
    best = lambda seconds: min(seconds[name] for name in names)  # noqa: E731
    actions = {"ours": ours, **{name: partial(theirs.solve, name) for name in names}}
    found = compare(actions, lambda seconds: seconds["ours"] / best(seconds), case.limit)
    mine, other = (1e6 * seconds / case.steps for seconds in (found.cpu("ours"), best({x: found.cpu(x) for x in names})))
    note = f"{mine:.2f} us a step, Exudyn {other:.2f}; errors {errors[0]:.1e} and {errors[1]:.1e}; {hht.engine_used}"
    line |= {**found.line(), "note": note, "ours_s": 1e-6 * mine}
    fair = errors[0] <= SAME_ERROR * errors[1]  # a larger error would make our steps cheap
    return line if fair else {**line, "verdict": BROKEN, "note": f"HHT's error is larger; {note}"}


def measure_chains(sizes: Sequence[int] = (1, 10)) -> list[dict[str, Any]]:
    """Lines of ``make bench-engine``."""
    return [measure(case) for case in CASES if case.links in sizes]


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
    times, broken = {}, 0
    for case in CASES:
        if not sizes or case.links in sizes:
            line = measure(case)
            times[case.links] = line["ours_s"]
            broken += line["verdict"] == BROKEN
            value = "" if line["value"] is None else f"{line['value']:.3f} [{line['low']:.3f}, {line['high']:.3f}]"
            sys.stdout.write(f"{line['what']:12} ratio {value} of {case.limit:g}: {line['verdict']}; {line['note']}\n")
            sys.stdout.flush()
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
