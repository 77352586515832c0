"""Time per step on the planar chain beside Exudyn's, the growth with the number of links, and the peak memory.

Not a test: a loaded machine may not fail a build.  ``make bench-chain``, or ``python -m tests.performance.chain [N ...]``.
Both codes take the same steps of the same chain, one after the other in turn, so that both see the same machine.  Compared
are medians of the processor time of one step, all threads together: on an idle core that is the time on the clock, on a
shared one it is what remains comparable; the clock's ratio is printed beside it.  Modified Newton on both sides, equal
damping at infinite frequency.  The reference of both is the certified one of 16 links, else this method with a step
sixteen times smaller.
"""

from __future__ import annotations

import math
import resource
import sys
import time
from dataclasses import dataclass

import numpy as np

import hhtbench  # noqa: F401 - 64 bit before anything else
from hhtbench.counting import Work
from problems import planar_chain
from solvers._start import Place
from solvers.hht.control.plan import Constant
from solvers.hht.options import HHTOptions
from solvers.hht.run.history import columns
from solvers.hht.run.start import begin

try:
    import exudyn
    from exudyn import itemInterface as items
except ImportError:
    exudyn = None

RHO = 0.9  # damping factor at infinite frequency, of both codes
FINER = 16  # the reference's steps in one of the compared
SAME_ERROR = 1.5  # ratio to Exudyn's error up to which ours counts as not larger: the constants of two methods differ
LIMITS = {100: 1.5, 1000: 1.0, 10_000: 1.0}  # time per step over Exudyn's
GROWTH, MEMORY = 1.1, 2048.0  # exponent of N; [MiB]


@dataclass(frozen=True)
class Case:
    """One size."""

    links: int
    h: float  #: [s]
    steps: int
    finer: int = FINER  #: steps of the reference in one


CERTIFIED = 16  # links, the longest chain with a certified reference; 1000 steps lead to its second row
CASES = (
    Case(10, 1e-4, 400),
    Case(CERTIFIED, 1.25e-4, 1000),
    Case(100, 1e-4, 400),
    Case(1000, 1e-4, 100),
    Case(10_000, 1e-5, 30),
)


def clocks() -> np.ndarray:
    """Processor time of this process and the time on the clock [s]."""
    return np.array([time.process_time(), time.perf_counter()])


class Ours:
    """Steps of the compiled loops, one in a call."""

    def __init__(self, links: int, h: float) -> None:
        problem = planar_chain.problem(n_links=links)
        place = Place(0.0, problem.q0, problem.v0)
        started = begin(problem.system, HHTOptions(rho_inf=RHO), place, (None, None), h, Work())
        self.engine, self.state, self.h = started.engine, started.state, h
        self.times: list[np.ndarray] = []
        self.plan = Constant(h)
        self.rows = np.zeros((1, columns(self.engine.structure)))
        self.engine.march(self.state, self.plan, math.inf, np.array([h]), np.array([h]), self.rows, None)  # compiles

    def step(self) -> None:
        """One step, timed."""
        lengths, ends = np.array([self.h]), np.array([self.state.t + self.h])
        started = clocks()
        state, made, _ = self.engine.march(self.state, self.plan, math.inf, lengths, ends, self.rows, None)
        self.times.append(clocks() - started)
        if not made:
            raise SystemExit(f"a step of {self.h} s from t = {self.state.t} failed")
        self.state = state


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
        self.times: list[np.ndarray] = []

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

    def run(self, between: object) -> None:
        """All steps, timed; ``between()`` runs before each and is not counted."""
        marks: list[tuple[np.ndarray, np.ndarray]] = []

        def before(_mbs: object, _t: float) -> bool:
            arrived = clocks()
            between()  # type: ignore[operator]
            marks.append((arrived, clocks()))
            return True

        self.mbs.SetPreStepUserFunction(before)
        solver = exudyn.MainSolverImplicitSecondOrder()
        if not solver.SolveSystem(self.mbs, self.settings):
            raise SystemExit("Exudyn did not finish")
        end = clocks()
        lefts, rights = [left for _, left in marks], [arrived for arrived, _ in marks[1:]] + [end]
        self.times = [right - left for left, right in zip(lefts, rights, strict=True)]

    @property
    def q(self) -> np.ndarray:
        """(3 N,) coordinates: displacements from the start, and the start."""
        moved = np.array(self.mbs.systemData.GetODE2Coordinates())
        start = np.zeros((moved.size // 3, 3))
        start[:, 0] = (np.arange(len(start)) + 0.5) / len(start)
        return moved + start.ravel()


def measure(case: Case) -> tuple[float, float]:
    """Median time of one of our steps [s] and its ratio to Exudyn's; prints the line of this size."""
    ours = Ours(case.links, case.h)
    theirs_time, told, fair = np.full(2, np.nan), "exudyn is not installed", False
    if exudyn is not None:
        theirs = Theirs(case.links, case.h, case.steps)
        theirs.run(ours.step)
        theirs_time = np.median(theirs.times, axis=0)
        reference = refined(case)
        errors = [float(np.abs(q - reference).max()) for q in (ours.state.q, theirs.q)]
        fair = errors[0] <= SAME_ERROR * errors[1]  # a larger error would make our steps cheap
        told = f"errors {errors[0]:.1e}, {errors[1]:.1e}: {'ours is not larger' if fair else 'OURS IS LARGER'}"
    else:
        for _ in range(case.steps):
            ours.step()
    ours_time = np.median(ours.times, axis=0)
    (ratio, on_clock), limit = ours_time / theirs_time, LIMITS.get(case.links, math.inf)
    verdict = "" if case.links not in LIMITS else ("holds" if fair and ratio <= limit else "BROKEN")
    kind = ours.engine.functions.analysis.kind
    sys.stdout.write(
        f"{case.links:6d} links  {kind:6s} ours {1e6 * ours_time[0]:7.0f} us  exudyn {1e6 * theirs_time[0]:7.0f} us  "
        f"ratio {ratio:4.2f} of {limit:g} {verdict:6s} (clock {on_clock:4.2f})  {told}\n"
    )
    sys.stdout.flush()
    return float(ours_time[0]), float(ratio) if fair else math.inf


def refined(case: Case) -> np.ndarray:
    """q (3 N,) at the end of ``case``: the certified value, or with steps ``finer`` times smaller."""
    known = planar_chain.problem(n_links=case.links, t_end=1.0).reference
    if known is not None:
        rows = np.flatnonzero(np.isclose(known["t"], case.h * case.steps, rtol=1e-12, atol=0.0))
        if rows.size:
            return np.asarray(known["q"][rows[0]])
    reference = Ours(case.links, case.h / case.finer)
    for _ in range(case.steps * case.finer):
        reference.step()
    return reference.state.q


def main(sizes: list[int]) -> int:
    """Measure the sizes asked for, all of them by default; 1 if a limit breaks."""
    cases = [case for case in CASES if not sizes or case.links in sizes]
    times, broken = {}, 0
    for case in cases:
        seconds, ratio = measure(case)
        if case.links != CERTIFIED or sizes:
            times[case.links] = seconds
        broken += ratio > LIMITS.get(case.links, math.inf)
    if len(times) > 1:
        first, last = min(times), max(times)
        growth = math.log(times[last] / times[first]) / math.log(last / first)
        steepest = max(math.log(times[b] / times[a]) / math.log(b / a) for a, b in zip(times, list(times)[1:], strict=False))
        sys.stdout.write(f"time per step grows like N^{growth:.2f} from {first} to {last} links (limit {GROWTH}), ")
        sys.stdout.write(f"at most N^{steepest:.2f} between neighbours\n")
        broken += growth > GROWTH
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    sys.stdout.write(f"peak memory of this process {peak:.0f} MiB (limit {MEMORY:.0f})\n")
    return 1 if broken or peak > MEMORY else 0


if __name__ == "__main__":
    sys.exit(main([int(size) for size in sys.argv[1:]]))
