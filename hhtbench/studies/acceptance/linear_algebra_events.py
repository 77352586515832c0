"""Derivatives that are wrong, linear algebra, and events (rows J1 to J5, E1, E2)."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np

import hhtbench as hb
from hhtbench.arguments import Matrix
from hhtbench.conformance.subject import Declined
from hhtbench.studies.acceptance.asked import ALPHAS, Asked
from hhtbench.studies.acceptance.rows import Finding, bounded, every, row
from hhtbench.studies.acceptance.scenes import Q0, V0, Rod, apart, ends, plane, problem, refuses

STIFFNESS = np.array([[3e4, 1e4], [-2e4, 5e4]])  # not symmetric: its transpose is another matrix [1/s^2]
DAMPING = np.array([[3.0, 1.0], [-2.0, 5.0]])  # [1/s]
REST = np.array([0.6, -0.9])


def _force(t: float, q: Any, v: Any) -> Any:
    stretch = q - REST
    return -STIFFNESS @ (stretch + stretch**3) - DAMPING @ v


def claiming(change: Any) -> hb.NumpySystem:
    """The pendulum on stiff springs with its declared force Jacobians changed."""

    def jacobians(t: float, q: Any, v: Any) -> tuple[Matrix, Matrix]:
        return change(-STIFFNESS * (1.0 + 3.0 * (q - REST) ** 2)), change(-DAMPING)

    return plane(force=_force, force_jacobians=jacobians)


def _stiff(asked: Asked, system: Any, alpha: float | None) -> hb.Solution:
    request: dict[str, Any] = {"step": 0.005} if asked.is_hht else {"rtol": 1e-6}
    return asked.solve(problem(system, Q0, V0, (0.0, 0.1)), alpha=alpha, **request)


def _wrong(asked: Asked, changes: dict[str, Any], *others: hb.Status, least: float = 0.0) -> Finding:
    """Against the right one; ``least``: iterations over its own, where the solver tells them."""
    worst, more, faults = 0.0, [], {}
    for alpha in ALPHAS if asked.is_hht else (None,):
        right = _stiff(asked, claiming(lambda x: x), alpha)
        for case, change in changes.items():
            found = _stiff(asked, claiming(change), alpha)
            difference = apart(found, right) if found.success else 0.0
            worst = max(worst, difference)
            fault = ends(found, hb.Status.success, *others)
            allowed = 1e-9 * np.abs(right.v).max() if asked.is_hht else 1e-4 * np.abs(right.v).max()
            fault = fault or ("" if difference <= allowed else f"off by {difference:.1e}")
            more.append((found.counters.newton_iterations or 0) / max(right.counters.newton_iterations or 1, 1))
            if asked.is_hht and not fault and more[-1] < least:
                fault = f"{more[-1]:.2g} times the iterations: the Jacobian is not used"
            faults[f"{case} alpha={alpha}"] = fault
    return every(faults, f"off by at most {worst:.1e}, {max(more):.2g} times the iterations")


SLIGHTLY = {"90 %": lambda x: 0.9 * x, "110 %": lambda x: 1.1 * x, "twice": lambda x: 2.0 * x}
WRONG = {"sign": lambda x: -x, "zero": lambda x: 0.0 * x, "transposed": lambda x: x.T, "1e6": lambda x: 1e6 * x}
WRONG_JACOBIANS: dict[str, Any] = {**SLIGHTLY, **WRONG}


@row("J1", "declared force Jacobian wrong by 10 %, twice as large", "result, more iterations")
def slightly_wrong(asked: Asked) -> Finding:
    """HHT uses the Jacobian as it is declared."""
    return _wrong(asked, SLIGHTLY, least=1.05)


@row("J2", "its sign, zero, transposed, 1e6 times", "result by differences, or newton_failed; never wrong in silence")
def altogether_wrong(asked: Asked) -> Finding:
    """As a failure says, or right."""
    return _wrong(asked, WRONG, hb.Status.newton_failed)


@row("J3", "Jacobians NaN, of the wrong shape", "nonfinite_callback with the name; refused with the shapes")
def broken(asked: Asked) -> Finding:
    """Of force and constraint."""
    good: dict[str, Any] = {"force_jacobians": (np.zeros((2, 2)), np.zeros((2, 2))), "constraint_jacobian": Q0[None, :]}
    faults = {}
    for name, value in good.items():
        nan = tuple(x * np.nan for x in value) if isinstance(value, tuple) else value * np.nan
        long = (np.zeros((2, 3)), np.zeros((3, 2))) if isinstance(value, tuple) else np.zeros((3, 2))
        for way, request in asked.ways().items():
            given = problem(plane(**{name: lambda *x, nan=nan: nan}), Q0, V0)
            faults[f"{name} NaN {way}"] = ends(asked.solve(given, **request), hb.Status.nonfinite_callback, words=(name,))
            given = problem(plane(**{name: lambda *x, long=long: long}), Q0, V0)
            faults[f"{name} shape {way}"] = refuses(partial(asked.solve, given, **request), name)
    return every(faults)


@row("J4", "hhtbench check on the faults of J1 to J3", "each named, with its worst entry")
def checked(asked: Asked) -> Finding:
    """No solver takes part: the check of a problem."""
    asked.hht(Rod())
    systems = {case: claiming(change) for case, change in WRONG_JACOBIANS.items()}
    systems["NaN"] = plane(force_jacobians=lambda *x: (np.full((2, 2), np.nan),) * 2)
    systems["shape"] = plane(force_jacobians=lambda *x: (np.zeros((2, 3)), np.zeros((3, 2))))
    faults = {}
    for case, system in systems.items():
        failed = {x.id: str(x.measured) for x in hb.check(problem(system, Q0, V0)).rows if x.passed is False}
        words = {"NaN": "[0, 0] = nan", "shape": "(2, 3)"}.get(case, "given ")
        told = failed.get("shape/force_jacobians" if case == "shape" else "derivative/force_q", "nothing")
        faults[case] = "" if words in told else f"{told}, without {words!r}"
    return every(faults)


@row("J5", "dense, banded, sparse linear algebra", "equal to 1e-11")
def linear_algebra(asked: Asked) -> Finding:
    """A chain of 40 links at fixed steps."""
    given = hb.load_problem("planar_chain(n_links=40)")
    found = [
        asked.hht(given.system, linsolver=kind).solve((0.0, 0.05), given.q0, given.v0, step=0.005)
        for kind in ("dense", "band", "sparse")
    ]
    worst = max(apart(x, found[0]) for x in found[1:])
    return bounded(worst, 1e-11 * max(1.0, float(np.abs(found[0].v).max())), "differ by")


FREE = hb.NumpySystem(force=lambda t, q, v: np.zeros(1))  # with v = 1 the coordinate is the time


class Own(Exception):
    """Of an event."""


def _times(asked: Asked, function: Any, request: dict[str, Any], t_span: tuple[float, float] = (0.0, 1.0)) -> Any:
    if not asked.is_hht:
        raise Declined("the adapters have no events")
    event = function if isinstance(function, hb.Event) else hb.Event(function)
    return asked.solve(problem(FREE, [t_span[0]], [1.0], t_span), events=event, **request)


def _found(solution: hb.Solution, expected: list[float]) -> str:
    if not solution.success:
        return ends(solution, hb.Status.success)
    times = np.asarray(solution.t_events[0])
    good = times.size == len(expected) and np.allclose(times, expected, rtol=0, atol=1e-9)
    return "" if good else f"found {times.tolist()}"


@row(
    "E1",
    "zero at t0; at t1; two in a step; tangent; NaN; raising; jump",
    "none; one; both; no promise; nonfinite_callback; its type; to 1e-9",
)
def events(asked: Asked) -> Finding:
    """On a coordinate that is the time."""
    faults, jump = {}, 0.123456789
    for way, request in asked.ways().items():
        cases: dict[str, tuple[Any, list[float]]] = {
            "at t0": (lambda t, q, v: q[0], []),
            "at t1": (lambda t, q, v: q[0] - 1.0, [1.0]),
            "two": (hb.Event(lambda t, q, v: (q[0] - 0.3) * (q[0] - 0.304), samples=20), [0.3, 0.304]),
            "jump": (lambda t, q, v: np.sign(q[0] - jump), [jump]),
        }
        for case, (function, expected) in cases.items():
            faults[f"{case} {way}"] = _found(_times(asked, function, request), expected)
        tangent = _times(asked, lambda t, q, v: (q[0] - 0.5) ** 2, request)
        faults[f"tangent {way}"] = ends(tangent, hb.Status.success)
        nan = _times(asked, lambda t, q, v: np.nan if q[0] > 0.5 else 1.0, request)
        faults[f"NaN {way}"] = ends(nan, hb.Status.nonfinite_callback)

        def raising(t: float, q: Any, v: Any) -> float:
            if q[0] > 0.5:
                raise Own
            return 1.0

        faults[f"raising {way}"] = refuses(partial(_times, asked, raising, request), kinds=(Own,))
    return every(faults)


@row("E2", "one event function in two solves, two solvers, two threads", "no shared record: times equal")
def shared_event(asked: Asked) -> Finding:
    """Ten rounds of two threads."""
    event = hb.Event(lambda t, q, v: q[0] - 0.37)
    request = {"rtol": 1e-4}
    alone = _times(asked, event, request).t_events[0].tolist()
    with ThreadPoolExecutor(2) as pool:
        rounds = [list(pool.map(lambda _: _times(asked, event, request).t_events[0].tolist(), range(2))) for _ in range(10)]
    different = sum(times != alone for pair in rounds for times in pair)
    return Finding(measured=f"{different} of 20 differ; {len(alone)} event each", holds=not different and len(alone) == 1)
