"""Three scenes of the wing in Exudyn, made from the numbers of our own problems; their equations are the same.

``spinup_beam``: ``ObjectBeamGeometricallyExact2D``, two nodes and one point of integration as in our elements.
``bushing_chain``: rigid bodies in the plane, for each bushing a Cartesian spring-damper and one of the angles.  The dampers
differ from ours by terms of the size of offset times rate; Exudyn's connector of six stiffnesses takes twice as long.
``cable_pendulum``: ``ObjectANCFCable2D`` with its mixed Lobatto and Gauss points, those of ``hhtbench.mechanics.cables``.
Exudyn: J. Gerstmayr, Multibody System Dynamics 60 (2024) 533-561.  Its build without range checks is taken.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.problem import Problem

try:
    sys.exudynFast = True  # type: ignore[attr-defined]  # read when Exudyn is imported for the first time
    import exudyn
    from exudyn import itemInterface as items
    from exudyn.advancedUtilities import CreateSymbolicUserFunction
except ImportError:
    exudyn = None


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What may be chosen of Exudyn's generalised-alpha."""

    steps: int
    rho: float = 0.9  #: spectral radius at infinite frequency
    modified: bool = True  #: keep the matrix of Newton's method over steps
    linear: str = "EigenSparse"  #: or EXUdense
    newton: float = 1e-8  #: relative tolerance of Newton's method
    residual: float = 1e-6  #: absolute one [N]; the default 1e-10 is below the roundoff of the beam's forces


class Theirs:
    """One problem in Exudyn; its coordinates are ours less those of the unstrained shape."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.container = exudyn.SystemContainer()
        self.mbs = self.container.AddSystem()
        self.kept = BUILT[problem.name](self.mbs, problem)  # expressions of functions must outlive the system
        self.mbs.Assemble()

    def settings(self, chosen: Settings) -> Any:
        """Return ``chosen`` as Exudyn takes it; nothing is written or drawn."""
        settings = exudyn.SimulationSettings()
        integration = settings.timeIntegration
        integration.endTime, integration.numberOfSteps = self.problem.t_span[1], chosen.steps
        integration.generalizedAlpha.spectralRadius = chosen.rho
        integration.newton.useModifiedNewton = chosen.modified
        integration.newton.relativeTolerance, integration.newton.absoluteTolerance = chosen.newton, chosen.residual
        integration.adaptiveStep = False
        settings.linearSolver.solverType = getattr(exudyn.LinearSolverType, chosen.linear)
        settings.solution.file.write = settings.solution.sensors.active = False
        settings.parallel.numberOfThreads = 1
        return settings

    def solve(self, settings: Any) -> bool:
        """Integrate from the start; False if Newton's method fails."""
        return bool(exudyn.MainSolverImplicitSecondOrder().SolveSystem(self.mbs, settings))

    def error(self, chosen: Settings) -> float:
        """Return the largest scaled error of q and v at rows of the reference where steps end; inf after a failure."""
        rows: list[tuple[float, Vector, Vector]] = []

        def keep(mbs: Any, t: float) -> bool:
            coordinates, velocities = self.states
            rows.append((t, np.array(coordinates()), np.array(velocities())))
            return True

        self.mbs.SetPostStepUserFunction(keep)
        ended = self.solve(self.settings(chosen))
        self.mbs.SetPostStepUserFunction(0)
        return _error(self.problem, rows) if ended else math.inf

    @property
    def states(self) -> tuple[Any, Any]:
        """Functions that return coordinates and velocities."""
        return self.mbs.systemData.GetODE2Coordinates, self.mbs.systemData.GetODE2Coordinates_t


def _error(problem: Problem, rows: list[tuple[float, Vector, Vector]]) -> float:
    reference: Any = problem.reference
    times, moved, v = (np.array(part) for part in zip(*rows, strict=True))
    largest, compared = 0.0, 0
    for t, *true in zip(reference["t"], reference["q"], reference["v"], strict=True):
        at = int(np.argmin(np.abs(times - t)))
        if t > problem.t_span[0] and abs(times[at] - t) < 1e-9 * problem.t_span[1]:
            compared += 1
            for got, truth, scale in zip(
                (moved[at] + unstrained(problem), v[at]), true, (problem.scales.q, problem.scales.v), strict=True
            ):
                largest = max(largest, float(np.max(np.abs(got - truth) / scale)))
    if compared < len(reference["t"]) // 2:
        raise ValueError(f"{compared} of {len(reference['t'])} rows of the reference lie at ends of steps.")
    return largest


def unstrained(problem: Problem) -> Vector:
    """Our coordinates of the shape from which Exudyn counts: all scenes start there."""
    return np.asarray(problem.q0)


def numbers(problem: Problem, *names: str) -> tuple[float, ...]:
    """Return parameters of the problem's system."""
    return tuple(float(getattr(problem.system, name)) for name in names)


def spinup_beam(mbs: Any, problem: Problem) -> object:
    """Elements from the hub, whose angle is an expression that Exudyn evaluates without Python."""
    length, EA, GA, EI, mass, inertia = numbers(problem, "element", "EA", "GA", "EI", "rho_A", "rho_I")
    nodes = [mbs.AddNode(items.NodeRigidBody2D(referenceCoordinates=list(row))) for row in _rows(problem, 3)]
    section = {"length": length, "massPerLength": mass, "crossSectionInertia": inertia}
    section |= {"bendingStiffness": EI, "axialStiffness": EA, "shearStiffness": GA}
    for ends in pairwise(nodes):
        mbs.AddObject(items.ObjectBeamGeometricallyExact2D(nodeNumbers=list(ends), **section))
    ground = _ground(mbs)
    for coordinate in range(3):
        held = mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=nodes[0], coordinate=coordinate))
        row = mbs.AddObject(items.ObjectConnectorCoordinate(markerNumbers=[ground, held]))
    rate, spin_up = numbers(problem, "rate", "spin_up")
    turn, symbolic = 2 * math.pi / spin_up, exudyn.symbolic

    def angle(mbs: Any, t: Any, itemNumber: Any, lOffset: Any) -> Any:
        early = rate / spin_up * (t * t / 2 + (symbolic.cos(turn * t) - 1) / turn**2)
        return symbolic.IfThenElse(t < spin_up, early, rate * (t - spin_up / 2))

    expression = CreateSymbolicUserFunction(mbs, angle, "offsetUserFunction", itemIndex=row)
    mbs.SetObjectParameter(row, "offsetUserFunction", expression)
    return expression


def bushing_chain(mbs: Any, problem: Problem) -> None:
    """Bars, each on a bushing at the end of the last one."""
    system: Any = problem.system
    springs = system.elements["bushing"]
    m, J, length, g = map(float, (system.m[0], system.J[0], -2 * springs.rows.b[0, 0], -system.gravity[1]))
    (k, _, turning_k), (c, _, turning_c) = (
        np.asarray(part).tolist() for part in (springs.stiffness[:3], springs.damping[:3])
    )
    wall = mbs.AddObject(items.ObjectGround())
    end, angle = mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=wall, localPosition=[0, 0, 0])), _ground(mbs)
    for row in _rows(problem, 3):
        node = mbs.AddNode(items.NodeRigidBody2D(referenceCoordinates=list(row)))
        bar = mbs.AddObject(items.ObjectRigidBody2D(mass=m, inertia=J, nodeNumber=node))
        _weigh(mbs, bar, g)
        begins, ends = (
            mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=bar, localPosition=[x, 0, 0]))
            for x in (-length / 2, length / 2)
        )
        turned = mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=node, coordinate=2))
        way = {"markerNumbers": [end, begins], "stiffness": [k, k, 0], "damping": [c, c, 0]}
        mbs.AddObject(items.ObjectConnectorCartesianSpringDamper(**way))
        turning = {"markerNumbers": [angle, turned], "stiffness": turning_k, "damping": turning_c}
        mbs.AddObject(items.ObjectConnectorCoordinateSpringDamper(**turning))
        end, angle = ends, turned


def cable_pendulum(mbs: Any, problem: Problem) -> None:
    """Elements of the cable in the plane, pinned at the first node."""
    length, EA, EI, mass, damping, g = numbers(problem, "length", "EA", "EI", "mass", "damping", "g")
    nodes = [
        mbs.AddNode(items.NodePoint2DSlope1(referenceCoordinates=list(row), initialVelocities=list(v)))
        for row, v in zip(_rows(problem, 4), np.asarray(problem.v0).reshape(-1, 4), strict=True)
    ]
    section = {"length": length / (len(nodes) - 1), "massPerLength": mass, "bendingStiffness": EI, "axialStiffness": EA}
    for ends in pairwise(nodes):
        cable = items.ObjectANCFCable2D(
            nodeNumbers=list(ends), axialDamping=damping, useReducedOrderIntegration=2, **section
        )
        _weigh(mbs, mbs.AddObject(cable), g)
    ground = _ground(mbs)
    for coordinate in range(2):
        held = mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=nodes[0], coordinate=coordinate))
        mbs.AddObject(items.ObjectConnectorCoordinate(markerNumbers=[ground, held]))


def _rows(problem: Problem, width: int) -> Matrix:
    """Return the unstrained coordinates, one row a node or body."""
    return unstrained(problem).reshape(-1, width)


def _ground(mbs: Any) -> Any:
    """Return a marker of a coordinate that is zero."""
    return mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=mbs.AddNode(items.NodePointGround()), coordinate=0))


def _weigh(mbs: Any, body: Any, g: float) -> None:
    mass = mbs.AddMarker(items.MarkerBodyMass(bodyNumber=body))
    mbs.AddLoad(items.LoadMassProportional(markerNumber=mass, loadVector=[0, -g, 0]))


BUILT = {"spinup_beam": spinup_beam, "bushing_chain": bushing_chain, "cable_pendulum": cable_pendulum}
