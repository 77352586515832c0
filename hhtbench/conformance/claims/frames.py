"""The same motion described otherwise: units, axes, origin, time, direction, halves."""

from __future__ import annotations

import pickle
import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from hhtbench.conformance.entry import claim
from hhtbench.conformance.scenes.moving_circle import moving_circle
from hhtbench.conformance.scenes.pendulum import Frame, RedundantPendulum, pendulum
from hhtbench.conformance.scenes.scene import SPAN, Scene
from hhtbench.conformance.subject import Declined, Subject, at, differences, errors, expect, rms, size_of
from hhtbench.request import make_request

TURNED = np.array([[2.0, -2.0, 1.0], [1.0, 2.0, 2.0], [-2.0, -1.0, 2.0]]) / 3.0
MIRRORED = np.diag([-1.0, 1.0, 1.0])
SWAPPED = np.eye(3)[[2, 0, 1]]
FAR = 4096.0  # origin of time [s]: its binary digits leave 1e-12 s to the times
STEPS = 40  # by hand


def _same_motion(subject: Subject, frame: Frame, multiplier: float | None = None) -> None:
    """The pendulum seen from ``frame`` moves as the plain one, with multipliers ``multiplier`` times as large."""
    plain, seen = subject.scene("position"), pendulum(frame=frame, t_span=(0.0, SPAN[1] * frame.time))
    coarse = subject.ladder(plain.problem)[1]
    times = np.linspace(0.0, 1.0, 7)
    one = subject.solved(plain, **at(coarse, SPAN[1] * times))
    other = subject.succeeds(seen.problem, **at(coarse, seen.problem.t_span[1] * times))
    bound = 4 * subject.bound(coarse, plain.problem)
    axes = np.eye(3) if frame.axes is None else frame.axes
    back_q = (other.q - np.array(frame.origin)) @ axes / frame.length
    back_v = other.v @ axes * frame.time / frame.length
    for name, back, known in (("q", back_q, one.q), ("v", back_v, one.v)):
        off = rms(back - known) / size_of(known)
        expect(off <= bound, f"{name} differs by {off:.1e} from the motion in the plain frame; expected {bound:.1e} at most")
    if multiplier is not None:
        off = rms(other.lam[:, :1] / multiplier - one.lam[:, :1]) / size_of(one.lam)
        expect(off <= 10 * bound, f"lam is not {multiplier:g} times that of the plain frame: off by {off:.1e}")


@claim("frame/rotation")
def rotation(subject: Subject) -> None:
    """Seen from turned axes the motion is the same, turned."""
    _same_motion(subject, Frame(axes=TURNED), 1.0)


@claim("frame/mirror")
def mirror(subject: Subject) -> None:
    """Seen in a mirror the motion is the same, mirrored."""
    _same_motion(subject, Frame(axes=MIRRORED), 1.0)


@claim("frame/order_of_coordinates")
def order_of_coordinates(subject: Subject) -> None:
    """With the coordinates in another order the motion is the same."""
    _same_motion(subject, Frame(axes=SWAPPED), 1.0)


@claim("frame/origin")
def origin(subject: Subject) -> None:
    """Seen from another origin the motion is the same, shifted."""
    _same_motion(subject, Frame(origin=(1.0, -2.0, 0.5)), 1.0)


@claim("units/length")
def unit_of_length(subject: Subject) -> None:
    """In millimetres the motion is the same."""
    _same_motion(subject, Frame(length=1e3), 1.0)


@claim("units/mass")
def unit_of_mass(subject: Subject) -> None:
    """In grams the motion is the same and the multipliers are a thousand times as large."""
    _same_motion(subject, Frame(mass=1e3), 1e3)


@claim("units/time")
def unit_of_time(subject: Subject) -> None:
    """In milliseconds the motion is the same and the multipliers are a millionth."""
    _same_motion(subject, Frame(time=1e3), 1e-6)


@claim("constraints/scaled_up")
def constraints_scaled_up(subject: Subject) -> None:
    """A hundred times the constraints give the same motion and a hundredth of the multipliers."""
    _same_motion(subject, Frame(scale=100.0), 0.01)


@claim("constraints/scaled_down")
def constraints_scaled_down(subject: Subject) -> None:
    """A hundredth of the constraints gives the same motion and a hundred times the multipliers."""
    _same_motion(subject, Frame(scale=0.01), 100.0)


@claim("constraints/sign")
def constraints_with_the_other_sign(subject: Subject) -> None:
    """Constraints of the other sign give the same motion and multipliers of the other sign."""
    _same_motion(subject, Frame(scale=-1.0), -1.0)


@claim("constraints/redundant")
def redundant_rows(subject: Subject) -> None:
    """A row given twice is told, or declined, or it changes nothing of the motion."""
    scene = pendulum(RedundantPendulum, name="redundant")
    request = subject.ladder(scene.problem)[1]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="redundant constraints")
        solution = subject.solve(scene.problem, **request)
    if not solution.success:
        told = "redundant" in solution.status.label or "g[" in solution.message or "depend" in solution.message
        expect(told, f"a row given twice ends with {solution.status.label}: {solution.message!r} does not say so")
        return
    known = np.array([scene.exact(float(t)).q for t in solution.t])
    off, bound = rms(solution.q - known), 10 * subject.bound(request, subject.scene("position").problem)
    expect(off <= bound, f"with a row given twice the error is {off:.1e}; expected {bound:.1e} at most")


def _near_exact(subject: Subject, scene: Scene, factor: float = 2.0, **request: Any) -> None:
    found = errors(scene, subject.succeeds(scene.problem, **request))
    bound = factor * subject.bound({k: x for k, x in request.items() if k != "t_eval"}, subject.scene("position").problem)
    worst = max(found["q"], found["v"])
    expect(worst <= bound, f"the error is {worst:.1e}; expected {bound:.1e} at most")


@claim("time/shift")
def shifted_start(subject: Subject) -> None:
    """Far from t = 0 the motion is the same."""
    scene = pendulum(t_span=(FAR, FAR + SPAN[1]))
    _near_exact(subject, scene, **subject.ladder(scene.problem)[1])


@claim("time/shift_of_moving_constraints")
def shifted_moving_constraints(subject: Subject) -> None:
    """Constraints that move are taken at the time at which they are asked for, far from t = 0 too."""
    scene = moving_circle(begin=64.0)
    _near_exact(subject, scene, **subject.ladder(scene.problem)[1])


@claim("time/backward")
def backward(subject: Subject) -> None:
    """From the end backward the motion comes back to the start."""
    scene = pendulum(t_span=(SPAN[1], 0.0), start=0.0)
    _near_exact(subject, scene, **subject.ladder(scene.problem)[1])


@claim("time/short")
def short_interval(subject: Subject) -> None:
    """An interval of a microsecond ends well."""
    scene = pendulum(t_span=(0.0, 1e-6))
    _near_exact(subject, scene, **subject.ladder(scene.problem)[0])


@claim("time/rest")
def rest(subject: Subject) -> None:
    """A pendulum that hangs at rest stays there, and its multiplier carries the weight."""
    scene = subject.scene("position")
    system = scene.problem.system
    hanging = np.array([0.0, -1.2, 0.0])
    problem = replace(scene.problem, name="rest", q0=hanging, v0=np.zeros(3), exact=None)
    solution = subject.succeeds(problem, **subject.ladder(problem)[0])
    off = float(np.max(np.abs(solution.q - hanging)))
    expect(off < 1e-9, f"it moves by {off:.1e} m")
    weight = float(system.mass) * 9.81 / 1.2  # type: ignore[union-attr]
    expect(np.allclose(np.abs(solution.lam[:, 0]), weight, rtol=1e-6), f"lam is {solution.lam[-1, 0]:.6g}, not {weight:.6g}")


def _restarted(subject: Subject, scene: Scene, pickled: bool) -> None:
    t0, t1 = scene.problem.t_span
    middle = (t0 + t1) / 2
    request = subject.ladder(scene.problem)[1]
    half = {name: value // 2 if name == "steps" else value for name, value in request.items()}
    whole = subject.solved(scene, **request)
    first = subject.succeeds(replace(scene.problem, t_span=(t0, middle)), **half)
    kept = pickle.loads(pickle.dumps(first)) if pickled else first
    if pickled:
        expect(np.array_equal(kept.q, first.q) and kept.status is first.status, "a solution does not survive pickling")
    q0, v0 = scene.put_back(middle, kept.q[-1], kept.v[-1])  # a drift within the error of the run is no consistent start
    rest_of = replace(scene.problem, t_span=(middle, t1), q0=q0, v0=v0)
    second = subject.succeeds(rest_of, **half)
    off = max(float(np.max(np.abs(second.q[-1] - whole.q[-1]))), float(np.max(np.abs(second.v[-1] - whole.v[-1]))) / 5)
    bound = 2 * subject.bound(request, scene.problem)
    expect(off <= bound, f"two halves end {off:.1e} beside the whole; expected {bound:.1e} at most")


@claim("restart/halves")
def two_halves(subject: Subject) -> None:
    """A run over the second half that starts where the first has ended is as good as one run."""
    _restarted(subject, subject.scene("position"), pickled=False)


@claim("restart/moving_constraints")
def two_halves_of_a_moving_constraint(subject: Subject) -> None:
    """The same where the constraints move."""
    _restarted(subject, subject.scene("rheonomic"), pickled=False)


@claim("restart/saved")
def saved_and_restored(subject: Subject) -> None:
    """A solution can be pickled, and a run that starts from what was read is as good as one run."""
    _restarted(subject, subject.scene("mixed"), pickled=True)


@claim("restart/checkpoint")
def checkpoint(subject: Subject) -> None:
    """Where the solver has a ``stepper``, steps that were saved and resumed end bit by bit as those that were not."""
    make = getattr(subject.solver, "stepper", None)
    if make is None:
        raise Declined(f"{subject.name} has no stepper(problem, request) with step, checkpoint and resume")
    scene = subject.scene("position")
    request = make_request(**subject.ladder(scene.problem)[1])
    going, saved = make(scene.problem, request), make(scene.problem, request)
    for index in range(STEPS):
        going.step(scene.problem.t_span[1])
        saved.step(scene.problem.t_span[1])
        if index == STEPS // 2:
            kept = saved.checkpoint()
            saved = make(scene.problem, request)
            saved.resume(kept)
    same = all(np.array_equal(getattr(going.state, name), getattr(saved.state, name)) for name in ("t", "q", "v"))
    expect(same, "steps that were saved and resumed go on otherwise than those that were not")


@claim("repeat/without_output")
def output_changes_nothing(subject: Subject) -> None:
    """The end of the motion does not depend, beyond the error, on how much output is asked for."""
    scene = subject.scene("position")
    request = subject.ladder(scene.problem)[1]
    whole = subject.solved(scene, **request)
    end = subject.solved(scene, **at(request, np.array([scene.problem.t_span[1]])))
    last = replace(whole, t=whole.t[-1:], q=whole.q[-1:], v=whole.v[-1:])
    off, bound = differences(end, last), subject.bound(request, scene.problem)
    expect(off <= bound, f"the end differs by {off:.1e} with output at the end alone; expected {bound:.1e} at most")
