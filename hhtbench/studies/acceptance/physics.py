"""Physics at its extremes: singular positions, sizes, jumps, long runs (rows P7 to P14)."""

from __future__ import annotations

import time
import warnings
from collections import Counter
from typing import Any

import numpy as np

import hhtbench as hb
from hhtbench.conformance.scenes.pendulum import Frame, pendulum
from hhtbench.conformance.subject import Declined
from hhtbench.studies.acceptance.asked import ALPHAS, Asked
from hhtbench.studies.acceptance.callbacks import FUNCTIONS
from hhtbench.studies.acceptance.rows import Finding, every, row
from hhtbench.studies.acceptance.scenes import Q0, V0, Rod, ends, over, plane, problem

STATUS = hb.Status


NAMED = (
    STATUS.newton_failed,
    STATUS.singular_iteration_matrix,
    STATUS.redundant_constraints,
    STATUS.step_too_small,
    STATUS.inconsistent_initial,
)
BEYOND = (STATUS.nonfinite_callback, STATUS.newton_failed, STATUS.step_too_small, STATUS.time_resolution)
JUDGED = 200  # rows of a run, at most, that are compared with a closed solution


@row(
    "P7",
    "through a singular position: flat parallelograms; a rod of length 0",
    "the right branch, or a named status, within 1 s; never the wrong one",
)
def singular_positions(asked: Asked) -> Finding:
    """Four bars of 1, 3, 5 windows at 1e-3..1e-7, after a solve of five steps: the closed solution is the right branch."""
    faults, passed, slowest = {}, 0, 0.0
    for windows in (1, 3, 5):
        given = hb.load_problem(f"four_bars(n_windows={windows}, t_end=1.0)")
        asked.solve(given, rtol=1e-3, max_num_steps=5)
        for tolerance in (1e-3, 1e-4, 1e-5, 1e-6, 1e-7):
            began = time.perf_counter()
            found = asked.solve(given, rtol=tolerance)
            slowest = max(slowest, time.perf_counter() - began)
            fault = ends(found, STATUS.success, *NAMED)
            if found.success:
                passed += 1
                fault = _off_branch(given, found)
            faults[f"{windows} windows {tolerance:g}"] = fault
    point = plane(constraint=lambda t, q: np.array([q @ q / 2]))
    found = asked.solve(problem(point, [0.0, 0.0], [0.0, 0.0]), rtol=1e-4)
    held = found.success and float(np.abs(found.q).max()) <= 1e-4
    faults["L = 0"] = "it leaves the point" if found.success and not held else ends(found, STATUS.success, *NAMED)
    return every(faults, f"{passed} passed, slowest {slowest:.2g} s", in_time=slowest <= 1)


def _off_branch(given: hb.Problem, found: hb.Solution) -> str:
    """The fault of a run that has left the closed solution at a row: another branch is 1 m away."""
    rows = np.unique(np.linspace(0, found.t.size - 1, JUDGED).astype(int))
    error = max(float(np.abs(found.q[i] - given.exact(float(found.t[i])).q).max()) for i in rows)  # type: ignore[misc]
    return "" if error <= 0.1 else f"off by {error:.2g} m"


def _long(size: float) -> hb.Problem:
    """The plane pendulum with ``size`` new units to the metre."""
    system, scales = Rod(gravity=9.81 * size, length=size), hb.Scales(q=size, v=size)
    return hb.Problem(name="long", system=system, q0=size * Q0, v0=size * V0, t_span=(0.0, 1.0), scales=scales)


@row(
    "P8",
    "lengths 1e-100..1e100 with units to match, atol = 1e-10 L; 1e-160",
    "the trajectory over L to 1e-6; there to 1e-2, or a status with a cause",
)
def lengths(asked: Asked) -> Finding:
    """Against the same solver at L = 1.  The smallest number is 5e-4 of the square of 1e-160."""
    faults, worst = {}, 0.0
    for way, request in asked.ways().items():
        more = {} if "step" in request else {"atol": 1e-10}
        right = asked.solve(_long(1.0), **request, **more)
        for power in (-100, -50, -6, 6, 50, 100):
            size = 10.0**power
            scaled = {} if "step" in request else {"atol": 1e-10 * size}
            found = asked.solve(_long(size), **request, **scaled)
            fault = ends(found, STATUS.success)
            if not fault:
                error = float(np.abs(found.q[-1] / size - right.q[-1]).max())
                worst, fault = max(worst, error), "" if error <= 1e-6 else f"off by {error:.1e}"
            faults[f"1e{power} {way}"] = fault
        found = asked.solve(_long(1e-160), **request, max_seconds=10.0)
        fault = ends(found, STATUS.success, *NAMED, *BEYOND)
        if found.success:
            error = float(np.abs(found.q[-1] / 1e-160 - right.q[-1]).max())
            fault = "" if error <= 1e-2 else f"off by {error:.1e}"
        faults[f"1e-160 {way}"] = fault
    return every(faults, f"largest difference {worst:.1e}")


@row(
    "P9",
    "a length of 1e-9 with atol left at its default and at 1e-6; a vibration of 1e-13 from rest at 0, with both",
    "the trajectory; a warning that atol exceeds the solution",
)
def absolute_tolerance(asked: Asked) -> Finding:
    """The default follows from the problem's scales; nothing at the start tells of the vibration."""
    given = over(pendulum(frame=Frame(length=1e-9)), 0.0, 1.0)
    fine, warned = asked.solve(given, rtol=1e-5), _warned(asked, given, 1e-6)
    right = asked.solve(over(pendulum(), 0.0, 1.0), rtol=1e-5)
    error = float(np.abs(fine.q[-1] / 1e-9 - right.q[-1]).max()) if fine.success else np.inf
    faults = {"trajectory": "" if error < 1e-3 else f"off by {error:.1e}", "warning": "" if warned else "none"}
    shaken = hb.NumpySystem(
        force=lambda t, q, v: np.array([1e-9 * np.sin(50.0 * t) - 1e4 * q[0], -9.81]),
        constraint=lambda t, q: q[1:],
        constraint_jacobian=lambda t, q: np.array([[0.0, 1.0]]),
    )
    for case, atol in {"default": None, "1e-06": 1e-6}.items():
        found = _warned(asked, problem(shaken, np.zeros(2), np.zeros(2), (0.0, 1.0)), atol)
        faults[f"from rest, atol {case}"] = "" if found else "a success without a digit, and no warning"
    return every(faults, f"off by {error:.1e}")


def _warned(asked: Asked, given: hb.Problem, atol: float | None) -> bool:
    """Whether a solve tells, by a warning or in its message, that atol is larger than the solution."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = asked.solve(given, rtol=1e-5, atol=atol)
    told = [*(str(x.message) for x in caught), found.message]
    return any("atol" in x and ("exceed" in x or "larger" in x or "size" in x) for x in told)


@row(
    "P10",
    "gravity 1e200, 1e308, 5e-324; overflow in f",
    "the cause named, without spending the budget of time; on the circle at 5e-324, to 1e-3",
    long=True,
)
def gravities(asked: Asked) -> Finding:
    """Ten seconds allowed; at 1e200 m/s^2 a swing takes 1e-100 s, so that no success can be right."""
    faults = {}
    for gravity in (1e200, 1e308):
        for way, request in asked.ways().items():
            found = asked.solve(problem(Rod(gravity=gravity), Q0, V0, (0.0, 1.0)), **request, max_seconds=10.0)
            faults[f"{gravity:g} {way}"] = ends(found, *BEYOND)
            if asked.is_hht and not any(
                x in found.message for x in ("products with force[1]", "at any tolerance", "arrive")
            ):
                faults[f"{gravity:g} {way}"] = f"the cause is not named: {found.message}"
    for way, request in asked.ways().items():
        found = asked.solve(problem(Rod(gravity=5e-324), Q0, V0, (0.0, 1.0)), **request, max_seconds=10.0)
        fault = ends(found, STATUS.success)
        if not fault:
            error = float(np.abs(found.q[-1] - [np.sin(1.5), -np.cos(1.5)]).max())  # from an angle of 1 at 0.5 rad/s
            fault = "" if error <= 1e-3 else f"off by {error:.1e}"
        faults[f"5e-324 {way}"] = fault
    burst = plane(
        force=lambda t, q, v: np.array([0.0, -9.81]) * 10.0 ** (400 * (t > 0.5)) if t <= 0.5 else np.full(2, np.inf)
    )
    faults["overflow"] = ends(asked.solve(problem(burst, Q0, V0), rtol=1e-4), STATUS.nonfinite_callback)
    return every(faults)


FLIP = 0.4321  # [s]


@row("P11", "a force that flips at a known time, declared as an event", "a step lands there; error at most 1e-5")
def declared_flip(asked: Asked) -> Finding:
    """A free mass: q = t - a t^2/2 to the flip, then pushed the other way."""
    if not asked.is_hht:
        raise Declined("the adapters have no events")

    def force(t: float, q: Any, v: Any) -> Any:
        return np.array([-9.81 if q[1] < 0.5 else 9.81, 0.0])

    flip = hb.Event(lambda t, q, v: t - FLIP, change=lambda t, q, v: (np.array([q[0], 1.0]), v), name="flip")
    worst, landed = 0.0, True
    for way in asked.ways().values():
        found = asked.solve(problem(hb.NumpySystem(force=force), [0.0, 0.0], [1.0, 0.0], (0.0, 1.0)), events=flip, **way)
        if not found.success:
            return Finding(measured=ends(found, STATUS.success), holds=False)
        at, speed = FLIP - 9.81 * FLIP**2 / 2, 1 - 9.81 * FLIP
        rest = 1.0 - FLIP
        worst = max(worst, abs(found.q[-1, 0] - (at + speed * rest + 9.81 * rest**2 / 2)))
        landed = landed and bool(np.any(np.abs(found.t - FLIP) < 1e-9))
    return Finding(
        measured=f"error {worst:.1e}, {'a row' if landed else 'no row'} at the flip", holds=worst <= 1e-5 and landed
    )


REST = 1.0 - FLIP  # [s]
FLIPPED = 1.0 - 9.81 * FLIP**2 / 2 - 9.81 * FLIP * REST + 9.81 * REST**2 / 2  # [m]: at 1 s, from 1 m/s
PLACES_AT_END = {"sign": (1 / 6, 5e-3), "tanh": (1 / 6, 1e-4), "flip": (FLIPPED, 1e-4)}  # [m], and what they may be off


def _sliding(law: Any) -> hb.Problem:
    """A block that Coulomb friction brings to rest after 1/3 s."""
    system = hb.NumpySystem(force=lambda t, q, v: -3.0 * law(v))
    return problem(system, [0.0], [1.0], (0.0, 1.0))


@row(
    "P12",
    "force flips undeclared; sign(v) sticking; tanh(v/1e-3)",
    "bounded: result, step_too_small or 20,000 steps; newton_failed of prescribed steps; the regularised one right",
)
def undeclared_flip(asked: Asked) -> Finding:
    """Places at the end: 1/6 m, and after the flip; in under ten seconds each; sign(v) to 5e-3, the others to 1e-4.

    A prescribed step has no shorter one to be too small: where Newton's iteration finds no root of it, that is the status.
    One of 0.01 that knows of no flip is off by its length, and is asked for an end alone there.
    """
    faults, slowest, worst = {}, 0.0, 0.0
    cases: dict[str, Any] = {
        "sign": _sliding(np.sign),
        "tanh": _sliding(lambda v: np.tanh(v / 1e-3)),
        "flip": problem(
            hb.NumpySystem(force=lambda t, q, v: np.array([9.81 if t > FLIP else -9.81])), [0.0], [1.0], (0.0, 1.0)
        ),
    }
    for case, given in cases.items():
        for way, request in asked.ways().items():
            began = time.perf_counter()
            found = asked.solve(given, **request, max_num_steps=20_000)
            slowest = max(slowest, time.perf_counter() - began)
            small = (STATUS.newton_failed,) if "step" in request else (STATUS.step_too_small, STATUS.max_steps)
            fault = ends(found, STATUS.success, *(small if case != "tanh" else ()))
            if found.success and not (case == "flip" and "step" in request):
                at, allowed = PLACES_AT_END[case]
                error = abs(float(found.q[-1, 0]) - at)
                worst, fault = max(worst, error), "" if error < allowed else f"off by {error:.1e}"
            faults[f"{case} {way}"] = fault
    return every(faults, f"off by at most {worst:.1e}, slowest {slowest:.2g} s", in_time=slowest < 10)


@row(
    "P13",
    "1e6 steps of a pendulum, h = 1e-3",
    "max |g|, |G z| at most 1e-9 throughout; alpha = 0: energy bounded",
    long=True,
)
def million_steps(asked: Asked) -> Finding:
    """IDA with GGL at 1e-6: 3.9e-9, 3.2e-8 and an energy off by 6.8e-5 m g L.  1e4 steps where they run in Python."""
    count = 10_000 if asked.engine == "python" else 1_000_000
    texts, good = [], True
    for alpha in ALPHAS:
        found = asked.hht(Rod(), alpha=alpha).solve((0.0, count * 1e-3), Q0, V0, steps=count)
        g = float(np.abs((found.q**2).sum(axis=1) - 1).max() / 2)
        gz = float(np.abs((found.q * found.v).sum(axis=1)).max())
        energy = (found.v**2).sum(axis=1) / 2 + 9.81 * found.q[:, 1]
        half = energy.size // 2
        first, second = (float(np.abs(x - energy[0]).max()) / 9.81 for x in (energy[:half], energy[half:]))
        texts.append(f"alpha = {alpha:g}: |g| {g:.1e}, |Gz| {gz:.1e}, energy {first:.1e} then {second:.1e} m g L")
        good = good and found.success and g <= 1e-9 and gz <= 1e-9 and (alpha != 0.0 or second <= 1.5 * first)
    return Finding(measured="; ".join(texts) + f" in {count} steps", holds=good)


@row(
    "P14",
    "a scene without stiffness, friction, velocity constraints",
    "optional parts not called; what is called is counted",
)
def optional_parts(asked: Asked) -> Finding:
    """Energy, power and invariants are for the bench alone; the rest: tests/hht/test_physics.py."""
    calls: Counter[str] = Counter()

    def counted(name: str, function: Any) -> Any:
        def call(*arguments: Any) -> Any:
            calls[name] += 1
            return function(*arguments)

        return call

    given: dict[str, Any] = {
        **{name: counted(name, function) for name, function in FUNCTIONS.items() if name != "mass_matrix"},
        "energy": counted("energy", lambda t, q, v: 0.0),
        "power": counted("power", lambda t, q, v, lam, mu: 0.0),
        "invariants": counted("invariants", lambda t, q, v: {}),
    }
    found = asked.solve(problem(plane(**given), Q0, V0), rtol=1e-5)
    idle = calls["energy"] + calls["power"] + calls["invariants"]
    told = (found.counters.residual_evaluations or 0) + (found.counters.output_evaluations or 0)
    return Finding(
        measured=f"{idle} calls of parts not needed, {calls['force']} of f, {calls.total()} of all, {told} counted",
        holds=idle == 0 and 0.9 * calls["force"] - 5 <= told <= 1.1 * calls.total() + 5,
    )
