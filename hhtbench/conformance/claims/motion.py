"""Claims on the motion: order, tolerance, both constraint levels, multipliers, energy, for every kind of equation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.integrate import simpson

from hhtbench.conformance.entry import claim
from hhtbench.conformance.scenes import SCENES
from hhtbench.conformance.scenes.pendulum import numpy_pendulum
from hhtbench.conformance.scenes.scene import Scene, multipliers
from hhtbench.conformance.scenes.small import oscillator
from hhtbench.conformance.subject import ROUNDOFF, STEPS, Declined, Subject, at, errors, expect, rms, size_of
from hhtbench.protocol.printing import exact
from hhtbench.protocol.system import declared
from hhtbench.solution.result import Status

EVERY = tuple(SCENES)
CONSTRAINED = tuple(name for name in EVERY if name != "unconstrained")
ENERGETIC = tuple(name for name in EVERY if name != "mass" and name != "mixed")
FALLS = 0.8  # least order of a method that claims none
MAX_SHORT = 0.2  # by how much a measured order may miss the claimed one
RECOVERED = 1e-6  # relative difference of multipliers from those of the acceleration level at the same state
DIFFERENCES = 1e-8  # violation of constraints whose derivatives are differences
DERIVATIVES = ("constraint_jacobian", "constraint_time_derivative", "constraint_acceleration", "force_jacobians")
UNEVEN = np.array([1.0, 2.0, 1.5, 3.0, 1.0])  # lengths of steps, as parts of one another
TILES = (40, 80)  # repetitions of these lengths in a run
STIFF = {"stiff": (1e10, 1e4), "viscous": (1e8, 1e8)}  # stiffness [1/s^2] and damping [1/s], of slow motions
MAX_EVALUATIONS = 4000  # that an implicit method may take there; an explicit one takes a hundred times as many
BETWEEN = 61  # rows of output between steps; odd, for Simpson's rule


@claim("rows", *EVERY)
def reaches_the_end(subject: Subject, name: str) -> None:
    """A success starts at the start, ends at the end, and has rows of numbers between them."""
    scene = subject.scene(name)
    for request in subject.ladder(scene.problem):
        solution = subject.solved(scene, **request)
        t0, t1 = scene.problem.t_span
        expect(solution.t[0] == t0, f"the first row is at {exact(solution.t[0])}, not at the start {exact(t0)}")
        expect(isinstance(solution.status, Status), f"status is {solution.status!r}")
        expect(isinstance(solution.message, str) and solution.message.strip(), "a success has no message")
        expect(solution.t[-1] == t1, f"the last row is at {exact(solution.t[-1])}, not at the end {exact(t1)}")
        expect(np.array_equal(solution.q[0], scene.problem.q0), "the first row is not q0")
        m, p = (getattr(scene.exact(t0), which).size for which in ("lam", "mu"))
        expect(solution.lam.shape[1:] == (m,) and solution.mu.shape[1:] == (p,), "lam or mu has the wrong width")


@claim("order", *EVERY, needs=("steps",))
def error_falls_with_the_step(subject: Subject, name: str) -> None:
    """With prescribed steps the error over the mesh falls with the order claimed (at least to the power 0.8)."""
    scene = subject.scene(name)
    if reason := subject.takes(scene.problem, steps=STEPS[0]):
        raise Declined(reason)
    _expect_orders(subject, scene, *(errors(scene, subject.solved(scene, steps=steps)) for steps in STEPS[-2:]))


@claim("order_of_changing_steps", "position", "velocity", "unconstrained", needs=("steps",))
def error_falls_with_changing_steps(subject: Subject, name: str) -> None:
    """The same with steps that are prescribed one by one and change from each to the next."""
    scene = subject.scene(name)
    t0, t1 = scene.problem.t_span
    asked = [np.tile(UNEVEN, count) * (t1 - t0) / (count * UNEVEN.sum()) for count in TILES]
    if reason := subject.takes(scene.problem, steps=asked[0]):
        raise Declined(reason)
    _expect_orders(subject, scene, *(errors(scene, subject.solved(scene, steps=lengths)) for lengths in asked))


def _expect_orders(subject: Subject, scene: Scene, coarse: dict[str, float], fine: dict[str, float]) -> None:
    """Assert that the errors fall with the claimed order when steps are halved."""
    wanted = FALLS if subject.claims.order is None else subject.claims.order - MAX_SHORT
    for which, error in fine.items():
        order = math.log2(max(coarse[which], 1e-300) / max(error, 1e-300))
        text = f"the error of {which} falls to the power {order:.2f} of the step to {error:.1e}; expected {wanted:.2f}"
        expect(order >= wanted or error < ROUNDOFF, text)


@claim("tolerance", *EVERY, needs=("rtol",))
def error_follows_the_tolerance(subject: Subject, name: str) -> None:
    """Under error control the error over the mesh stays below the tolerance times what is claimed, and falls with it."""
    scene = subject.scene(name)
    ladder = subject.ladder(scene.problem)
    found = [errors(scene, subject.solved(scene, **request)) for request in ladder]
    for request, error in zip(ladder, found, strict=True):
        for which in ("q", "v"):
            text = f"the error of {which} at rtol={request['rtol']:g} is {error[which]:.1e}"
            bound = subject.bound(request, scene.problem)
            expect(error[which] <= bound, f"{text}; expected {bound:.1e} at most")
    first, last = (max(error["q"], error["v"]) for error in (found[0], found[-1]))
    expect(last <= max(first / 5, ROUNDOFF), f"a hundred times tighter, the error goes from {first:.1e} to {last:.1e} only")


@claim("levels", *CONSTRAINED)
def constraints_hold(subject: Subject, name: str) -> None:
    """Position and velocity constraints hold at steps and between them, to the error of the run or to what is claimed."""
    scene = subject.scene(name)
    _, middle, fine = subject.ladder(scene.problem)
    between = at(middle, np.linspace(*scene.problem.t_span, BETWEEN))
    for where, request, asked in (("a step", middle, middle), ("a step", fine, fine), ("a row of t_eval", middle, between)):
        bound = subject.claims.drift or 10 * subject.bound(request, scene.problem)
        _expect_levels(scene, subject.solved(scene, **asked), bound, where)


def _expect_levels(scene: Scene, solution: Any, bound: float, where: str) -> None:
    for t, q, v in zip(solution.t, solution.q, solution.v, strict=True):
        found = scene.levels(float(t), q, v)
        for level, misfit in zip(("position", "velocity"), found, strict=True):
            worst = float(np.max(np.abs(misfit), initial=0.0))
            text = f"the {level} constraints are off by {worst:.1e} at {where}, t = {t:.6g}; expected {bound:.1e} at most"
            expect(worst <= bound, text)


@claim("multipliers", *CONSTRAINED)
def multipliers_are_those_of_the_acceleration_level(subject: Subject, name: str) -> None:
    """The multipliers of every row are those with which the constraints hold at the acceleration level of that row."""
    scene, request = subject.case(name, -1)
    _expect_acceleration_level(scene, subject.solved(scene, **request))


def _expect_acceleration_level(scene: Scene, solution: Any) -> None:
    held = zip(solution.t, solution.q, solution.v, strict=True)
    known = np.array([multipliers(scene.equations(float(t), q, v)) for t, q, v in held])
    given = np.hstack([solution.lam, solution.mu])
    worst = float(np.max(np.abs(given - known))) / size_of(known)
    expect(worst <= RECOVERED, f"lam and mu are off the acceleration level by {worst:.1e} of their size")


@claim("multiplier_error", *CONSTRAINED)
def multipliers_are_right(subject: Subject, name: str) -> None:
    """The multipliers of every row, and those the solver itself carries, are near the closed solution's."""
    scene, request = subject.case(name, -1)
    solution = subject.solved(scene, **request)
    bound = 10 * subject.bound(request, scene.problem)
    for which, error in errors(scene, solution).items():
        expect(error <= bound, f"the error of {which} is {error:.1e}; expected {bound:.1e} at most")


@claim("energy", *ENERGETIC)
def energy_is_balanced(subject: Subject, name: str) -> None:
    """Energy changes by the work of what is declared to feed it, to the error of the run."""
    scene, request = subject.case(name, -1)
    solution = subject.solved(scene, **at(request, np.linspace(*scene.problem.t_span, BETWEEN)))
    system = scene.problem.system
    energy = [float(declared(system, "energy")(*row)) for row in zip(solution.t, solution.q, solution.v, strict=True)]
    power, work = declared(system, "power"), 0.0
    if power is not None:
        rows = zip(solution.t, solution.q, solution.v, solution.lam, solution.mu, strict=True)
        work = float(simpson([float(power(*row)) for row in rows], x=solution.t))
    lost = abs(energy[-1] - energy[0] - work) / max(1.0, *np.abs(energy))
    bound = 10 * subject.bound(request, scene.problem)
    expect(lost <= bound, f"energy is off its balance by {lost:.1e} of its size; expected {bound:.1e} at most")


@claim(
    "callables",
    parts=("declared", "differences"),
    known={"collocation": (("differences",), "its iteration goes to roundoff, which Jacobians by differences do not reach")},
)
def plain_functions(subject: Subject, part: str) -> None:
    """A system of plain functions, with its derivatives declared or by differences, moves as the same one does in JAX."""
    left_out: dict[str, Any] = dict.fromkeys(DERIVATIVES if part == "differences" else ())
    scene = numpy_pendulum(**left_out)
    request = subject.ladder(scene.problem)[1]
    solution = subject.succeeds(scene.problem, **request)
    bound = subject.bound(request, scene.problem)
    for which in ("q", "v"):
        error = errors(scene, solution)[which]
        expect(error <= bound, f"the error of {which} is {error:.1e}; expected {bound:.1e} at most")
    _expect_acceleration_level(scene, solution)
    _expect_levels(scene, solution, max(DIFFERENCES, subject.claims.drift or 10 * bound), "a step")


EXPLICIT = ("stiff",), "its Jacobians are those of the constraints; in the forces it is explicit"


@claim("implicit", *STIFF, known={"rattle": EXPLICIT})
def implicit_methods_take_long_steps(subject: Subject, name: str) -> None:
    """A method that asks for Jacobians crosses a stiff but smooth motion with few evaluations."""
    scene = oscillator(name, *STIFF[name], free=0.0)
    request = subject.ladder(scene.problem)[0]
    plain = subject.solved(subject.scene("unconstrained"), **request)
    if not plain.counters.jacobian_evaluations:
        raise Declined(f"{subject.name} asks for no Jacobians")
    solution = subject.succeeds(scene.problem, **request, max_evaluations=MAX_EVALUATIONS)
    known = np.array([scene.exact(float(t)).q for t in solution.t])
    off = rms(solution.q - known)
    expect(off <= subject.bound(request, scene.problem), f"the error is {off:.1e}")


SEEKS = (
    ("position", "declared", "mass", "velocity", "mixed"),
    "it finds the longest step by trying: a start too long fails",
)


@claim("newton", *EVERY, known={"collocation": SEEKS})
def newton_is_quick(subject: Subject, name: str) -> None:
    """Where Newton's iterations are counted, a step of a smooth motion takes few and none fails."""
    scene, request = subject.case(name, -1)
    counters = subject.solved(scene, **request).counters
    if counters.newton_iterations is None or not counters.steps_accepted:
        raise Declined(f"{subject.name} does not report Newton's iterations")
    steps = counters.steps_accepted + (counters.steps_rejected_error or 0)
    each = counters.newton_iterations / steps
    most = subject.claims.iterations
    expect(each <= most, f"{each:.1f} iterations of Newton's a step, on a smooth motion; expected {most:g} at most")
    expect(not counters.steps_rejected_newton, f"{counters.steps_rejected_newton} steps failed by Newton's iteration")
