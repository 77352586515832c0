"""Claims on invariance: the same motion in other units, axes, origins, times, directions, or in two halves."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np

from hhtbench.conformance.entry import claim
from hhtbench.conformance.scenes.pendulum import Frame, pendulum
from hhtbench.conformance.scenes.scene import SPAN, Scene
from hhtbench.conformance.scenes.small import moving_circle
from hhtbench.conformance.subject import Subject, at, errors, expect, rms, size_of
from hhtbench.solution.request import make_request

TURNED = np.array([[2.0, -2.0, 1.0], [1.0, 2.0, 2.0], [-2.0, -1.0, 2.0]]) / 3.0
MIRRORED = np.diag([-1.0, 1.0, 1.0])
SWAPPED = np.eye(3)[[2, 0, 1]]
FAR = 4096.0  # origin of time [s]: its binary digits leave 1e-12 s to the times
STEPS = 40  # by hand


FRAMES: dict[str, tuple[Frame, float]] = {  # and by what it multiplies the multipliers
    "rotation": (Frame(axes=TURNED), 1.0),
    "mirror": (Frame(axes=MIRRORED), 1.0),
    "order_of_coordinates": (Frame(axes=SWAPPED), 1.0),
    "origin": (Frame(origin=(1.0, -2.0, 0.5)), 1.0),
    "length": (Frame(length=1e3), 1.0),
    "mass": (Frame(mass=1e3), 1e3),
    "time": (Frame(time=1e3), 1e-6),
    "constraints_scaled_up": (Frame(scale=100.0), 0.01),
    "constraints_scaled_down": (Frame(scale=0.01), 100.0),
    "constraints_of_the_other_sign": (Frame(scale=-1.0), -1.0),
}


@claim("frame", parts=FRAMES)
def frame_changes_nothing(subject: Subject, part: str) -> None:
    """Seen from other axes, in other units, with scaled constraints the motion is the same, multipliers are as scaled."""
    frame, multiplier = FRAMES[part]
    plain, seen = subject.scene("position"), pendulum(frame=frame, t_span=(0.0, SPAN[1] * frame.time))
    coarse = subject.ladder(plain.problem)[1]
    times = np.linspace(0.0, 1.0, 7)
    one = subject.solved(plain, **at(coarse, SPAN[1] * times))
    other = subject.succeeds(seen.problem, **at(coarse, seen.problem.t_span[1] * times))
    bound = 4 * subject.bound(coarse, plain.problem)
    axes = np.eye(3) if frame.axes is None else frame.axes
    back_q = (other.q - np.array(frame.origin)) @ axes / frame.length
    back_v = other.v @ axes * frame.time / frame.length
    back_lam = other.lam[:, :1] / multiplier
    for name, back, known, most in (
        ("q", back_q, one.q, bound),
        ("v", back_v, one.v, bound),
        ("lam", back_lam, one.lam[:, :1], 10 * bound),
    ):
        off = rms(back - known) / size_of(known)
        expect(off <= most, f"{name} differs by {off:.1e} from the motion in the plain frame; expected {most:.1e} at most")


TIMES: dict[str, Scene] = {
    "shift": pendulum(t_span=(FAR, FAR + SPAN[1])),
    "shift_of_moving_constraints": moving_circle(begin=64.0),
    "backward": pendulum(t_span=(SPAN[1], 0.0), start=0.0),
    "short": pendulum(t_span=(0.0, 1e-6)),
}


@claim("time", parts=TIMES)
def time_changes_nothing(subject: Subject, part: str) -> None:
    """Far from t = 0, backward, over a microsecond the motion is that of the closed solution, moving constraints' too."""
    scene = TIMES[part]
    request = subject.ladder(scene.problem)[1]
    found = errors(scene, subject.succeeds(scene.problem, **request))
    bound, worst = 2 * subject.bound(request, subject.scene("position").problem), max(found["q"], found["v"])
    expect(worst <= bound, f"the error is {worst:.1e}; expected {bound:.1e} at most")


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


RESTARTED = {"halves": "position", "moving_constraints": "rheonomic", "saved": "mixed"}


@claim("restart", parts=RESTARTED)
def two_halves(subject: Subject, part: str) -> None:
    """A run over the second half that starts where the first has ended, pickled or not, is as good as one run."""
    scene = subject.scene(RESTARTED[part])
    t0, t1 = scene.problem.t_span
    middle = (t0 + t1) / 2
    request = subject.ladder(scene.problem)[1]
    half = {name: value // 2 if name == "steps" else value for name, value in request.items()}
    whole = subject.solved(scene, **request)
    first = subject.succeeds(replace(scene.problem, t_span=(t0, middle)), **half)
    kept = pickle.loads(pickle.dumps(first)) if part == "saved" else first
    expect(np.array_equal(kept.q, first.q) and kept.status is first.status, "a solution does not survive pickling")
    q0, v0 = scene.put_back(middle, kept.q[-1], kept.v[-1])  # a drift within the error of the run is no consistent start
    second = subject.succeeds(replace(scene.problem, t_span=(middle, t1), q0=q0, v0=v0), **half)
    off = max(float(np.max(np.abs(second.q[-1] - whole.q[-1]))), float(np.max(np.abs(second.v[-1] - whole.v[-1]))) / 5)
    bound = 2 * subject.bound(request, scene.problem)
    expect(off <= bound, f"two halves end {off:.1e} beside the whole; expected {bound:.1e} at most")


@claim("restart/checkpoint", needs=("stepper",))
def checkpoint(subject: Subject) -> None:
    """Where the solver has a ``stepper``, steps that were saved and resumed end bit by bit as those that were not."""
    make = subject.having("stepper")
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
