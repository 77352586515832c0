"""Rows P1 to P14: stiffness, masses, ranks, singular positions, sizes, jumps, long runs."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.conformance.entry import Lane, tested
from hhtbench.conformance.rows.judging import Cases, apart, arrives, ends, row, warns, within
from hhtbench.conformance.scenes.linkages import DoublePendulum, double_pendulum, double_pendulum_angles
from hhtbench.conformance.scenes.rod import FUNCTIONS, MASSLESS, Q0, V0, Rod, plane, problem, two_rods
from hhtbench.conformance.subject import ALPHAS, Subject

STATUS = hb.Status
NAMED = (
    STATUS.newton_failed,
    STATUS.singular_iteration_matrix,
    STATUS.redundant_constraints,
    STATUS.step_too_small,
    STATUS.inconsistent_initial,
)
BEYOND = (STATUS.nonfinite_callback, STATUS.newton_failed, STATUS.step_too_small, STATUS.time_resolution)


@row(
    "P1",
    "spring of 1e2..1e14 N/m on a pendulum at fixed h = 1e-3",
    "success, at most 6 Newton iterations a step, error at most 1e-3",
    known={"ida": (("1e6", "1e8", "1e12", "1e14"), "errors of up to 0.09 at a tolerance of 1e-5")},
)
def stiffness(subject: Subject) -> Cases:
    """Yield the cases of row P1: spring of 1e2..1e14 N/m on a pendulum at fixed h = 1e-3.

    Against the rigid rod from 1e8 on; below that against a run with a tenth of the step. By tolerance for the others.
    """
    rigid: Any = hb.load_problem("stiff_spring_pendulum(stiffness=inf)").reference
    request, finer = ({"step": 1e-3}, {"step": 1e-4}) if subject.is_hht else ({"rtol": 1e-5}, {"rtol": 1e-8})
    for power in (2, 4, 6, 8, 10, 12, 14):
        given = hb.load_problem(f"stiff_spring_pendulum(stiffness=1e{power})")
        found = subject.ask(given, **request, t_eval=rigid["t"])
        if not found.success:
            yield f"1e{power}", arrives(found)
            continue
        exact = rigid["q"] if power >= 8 else subject.ask(given, **finer, t_eval=rigid["t"]).q
        yield f"1e{power}", within(np.abs(found.q - exact).max() / np.max(given.scales.q), 1e-3, "error")
        if subject.is_hht:
            iterations = (found.counters.newton_iterations or 0) / (found.counters.steps_accepted or 1)
            yield f"1e{power}, iterations", within(iterations, 6, "iterations a step:")


@row(
    "P2",
    "lower mass of a double pendulum 1e-8..1e8 times the upper one; fixed h = 1e-3",
    "success, error at most 1e-3; of HHT with b = 0, from where (H33) forbids h = 1e-3, or the tension's vibration named",
    lane=Lane.slow,
)
def mass_ratios(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row P2: lower mass of a double pendulum 1e-8..1e8 times the upper one; fixed h = 1e-3.

    Straight at the start; against DOP853 on the angles' own equations.
    """
    finer = {**request, "step": 1e-3} if "step" in request else request
    for power in (-8, -6, -4, -2, 0, 2, 4, 6, 8):
        ratio = 10.0**power
        exact, _ = DoublePendulum.bent(*double_pendulum_angles(0.5, ratio, 1.0))
        found = subject.ask(double_pendulum(ratio, 1.0), **finer, max_num_steps=50_000)
        forbidden = subject.is_hht and 1e-3 * DoublePendulum.fastest(ratio) > 2.0  # (H33) with b = 0, the default
        if found.success:
            yield f"1e{power}", within(np.abs(found.q[-1] - exact).max(), 1e-3, "error")
        else:
            known = (STATUS.newton_failed, STATUS.max_steps) if forbidden else (STATUS.success,)
            yield f"1e{power}", ends(found, *known, words=("onstraint forces carry a vibration",))


class MasslessAngle(hb.System):
    """The unit pendulum with its angle as a third coordinate that has no mass."""

    mass_matrix: Any = hb.parameter((1.0, 1.0, 0.0))

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Applied force: weight."""
        return jnp.stack([0.0 * t, -9.81 + 0.0 * t, 0.0 * t])

    def constraint(self, t: Any, q: Any) -> Any:
        """Position constraints: place and angle agree."""
        return jnp.stack([q[0] - jnp.sin(q[2]), q[1] + jnp.cos(q[2])])


@row("P3", "singular M, regular KKT matrix", "result, error at most 1e-6")
def singular_mass(subject: Subject) -> Cases:
    """Yield the cases of row P3: singular M, regular KKT matrix.

    A pendulum with its angle as a coordinate without mass; 4000 steps, or a tolerance of 1e-8.
    """
    exact = hb.solve(problem(Rod(), (0.0, 1.0)), "scipy(method='DOP853')", rtol=1e-12, atol=1e-13)
    for way, request in subject.alphas({"steps": 4000}, {"rtol": 1e-8}).items():
        found = subject.ask(MasslessAngle(), (0.0, 1.0), q0=[*Q0, 1.0], v0=[*V0, 0.5], **request)
        misses = (np.abs(getattr(found, x)[-1, :2] - getattr(exact, x)[-1]).max() for x in "qv")
        yield way, arrives(found) or within(max(misses), 1e-6, "error")


@row("P4", "singular KKT matrix: a coordinate with neither mass nor constraint", "singular_iteration_matrix that names it")
def singular_matrix(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row P4: a coordinate with neither mass nor constraint, with a constant mass and as a function."""
    function = hb.NumpySystem(mass_matrix=lambda t, q: np.diag([1.0, 0.0]), force=FUNCTIONS["force"])
    for case, system in {"constant": MASSLESS, "function": function}.items():
        yield case, ends(subject.ask(system, **request), STATUS.singular_iteration_matrix, words=("mass",))


@row("P5", "a constraint twice, also times 3.7, times 1e-8", "y, z, lam of least norm right, or redundant_constraints")
def duplicated(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row P5: a constraint twice, scaled by 1, 3.7 or 1e-8, compared with the single row."""
    right = subject.ask(plane(), (0.0, 0.3), **request)
    for factor in (1.0, 3.7, 1e-8):
        rows = np.array([1.0, factor])
        twice = plane(
            constraint=lambda t, q, rows=rows: rows * (q @ q - 1) / 2,
            constraint_jacobian=lambda t, q, rows=rows: rows[:, None] * q,
        )
        found = subject.ask(twice, (0.0, 0.3), **request)
        yield f"x {factor:g}, end", ends(found, STATUS.success, STATUS.redundant_constraints)
        if found.success:
            least = right.lam[-1, 0] * rows / (rows @ rows)
            yield f"x {factor:g}", within(apart(found, right), 1e-5)
            yield f"x {factor:g}, lam", within(np.abs(found.lam[-1] / least - 1.0).max(), 1e-4, "multipliers off by")


@row("P6", "contradictory constraints", "inconsistent_initial")
def contradictory(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the case of row P6: two rods of different lengths from the same point to the same mass."""
    yield "", ends(subject.ask(two_rods(), **request), STATUS.inconsistent_initial, words=("g[1]",))


@row("P7", "flat parallelograms; a rod of length 0", "the right branch, or a named status, within 1 s", seconds=1.0)
def singular_positions(subject: Subject) -> Cases:
    """Yield the cases of row P7: flat parallelograms; a rod of length 0.

    Four bars of 1, 3, 5 windows at 1e-3..1e-7, after a solve of five steps: the closed solution is the right branch.
    """
    for windows in (1, 3, 5):
        given = hb.load_problem(f"four_bars(n_windows={windows}, t_end=1.0)")
        subject.ask(given, rtol=1e-3, max_num_steps=5)
        subject.took.pop()
        for tolerance in (1e-3, 1e-4, 1e-5, 1e-6, 1e-7):
            found = subject.ask(given, rtol=tolerance)
            rows = np.unique(np.linspace(0, found.t.size - 1, 200 if found.success else 0).astype(int))
            off = [np.abs(found.q[i] - given.exact(float(found.t[i])).q).max() for i in rows]  # type: ignore[misc]
            fault = ends(found, STATUS.success, *NAMED)
            yield (
                f"{windows} windows {tolerance:g}",
                fault or within(max(off, default=0.0), 0.1, "another branch is 1 m off:"),
            )
    found = subject.ask(plane(constraint=lambda t, q: np.array([q @ q / 2])), q0=[0.0, 0.0], v0=[0.0, 0.0], rtol=1e-4)
    left = np.abs(found.q).max() if found.success else 0.0
    yield "L = 0", ends(found, STATUS.success, *NAMED) or within(left, 1e-4, "it leaves the point by")


def _long(subject: Subject, size: float, **request: Any) -> tuple[hb.Solution, np.ndarray]:
    """Solve the plane pendulum with ``size`` new units per metre; return the solution and its end divided by the size."""
    system, scales = Rod(gravity=9.81 * size, length=size), hb.Scales(q=size, v=size)
    given = hb.Problem(name="long", system=system, q0=size * Q0, v0=size * V0, t_span=(0.0, 1.0), scales=scales)
    found = subject.ask(given, **request)
    return found, found.q[-1] / size if found.success else np.full(2, np.nan)


@row("P8", "lengths 1e-100..1e100 with units to match; 1e-160", "the trajectory over L to 1e-6; to 1e-2, or a status")
def lengths(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row P8: lengths 1e-100..1e100 with units to match; 1e-160.

    Against the same solver at L = 1.  The smallest number is 5e-4 of the square of 1e-160.
    """
    scaled = (lambda size: {}) if "step" in request else (lambda size: {"atol": 1e-10 * size})
    _, right = _long(subject, 1.0, **request, **scaled(1.0))
    for power in (-100, -50, -6, 6, 50, 100):
        found, end = _long(subject, 10.0**power, **request, **scaled(10.0**power))
        yield f"1e{power}", arrives(found) or within(np.abs(end - right).max(), 1e-6)
    found, end = _long(subject, 1e-160, **request, max_seconds=10.0)
    allowed = within(np.abs(end - right).max(), 1e-2, "at 1e-160 off by")
    yield "1e-160", allowed if found.success else ends(found, *NAMED, *BEYOND)


BEYOND_ATOL = "exceeds the size of q"
SILENT = {
    "ida": (("warning", "from rest, atol default", "from rest, atol 1e-06"), "no warning of an atol beyond the solution")
}


@row("P9", "a length of 1e-9; a vibration of 1e-13 from rest", "a warning that atol exceeds the solution", known=SILENT)
def absolute_tolerance(subject: Subject) -> Cases:
    """Yield the cases of row P9: a length of 1e-9; a vibration of 1e-13 from rest.

    The default follows from the problem's scales; nothing at the start tells of the vibration.
    """
    (_, fine), (_, right) = (_long(subject, size, rtol=1e-5) for size in (1e-9, 1.0))
    yield "trajectory", within(np.abs(fine - right).max(), 1e-3)
    yield "warning", warns(lambda: _long(subject, 1e-9, rtol=1e-5, atol=1e-6)[0], BEYOND_ATOL)
    shaken = hb.NumpySystem(
        force=lambda t, q, v: np.array([1e-9 * np.sin(50.0 * t) - 1e4 * q[0], -9.81]),
        constraint=lambda t, q: q[1:],
        constraint_jacobian=lambda t, q: np.array([[0.0, 1.0]]),
    )
    rest: dict[str, Any] = {"q0": np.zeros(2), "v0": np.zeros(2), "rtol": 1e-5}
    for case, atol in {"default": None, "1e-06": 1e-6}.items():
        fault = warns(partial(subject.ask, shaken, (0.0, 1.0), **rest, atol=atol), BEYOND_ATOL)
        yield f"from rest, atol {case}", fault and f"a success without a digit: {fault}"


@row("P10", "gravity 1e200, 1e308, 5e-324; overflow in f; a jump to 1e12", "the cause is named", lane=Lane.slow)
def overflows(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row P10: gravity 1e200, 1e308, 5e-324; overflow in f; a jump to 1e12.

    Ten seconds allowed; at 1e200 m/s^2 a swing takes 1e-100 s, so that no success can be right.
    """
    for gravity in (1e200, 1e308):
        found = subject.ask(Rod(gravity=gravity), (0.0, 1.0), **request, max_seconds=10.0)
        named = any(x in found.message for x in ("products with force[1]", "at any tolerance", "arrive"))
        silent = f"the cause is not named: {found.message}" if subject.is_hht and not named else ""
        yield f"{gravity:g}", ends(found, *BEYOND) or silent
    found = subject.ask(Rod(gravity=5e-324), (0.0, 1.0), **request, max_seconds=10.0)
    error = np.abs(found.q[-1] - [np.sin(1.5), -np.cos(1.5)]).max()  # from an angle of 1 at 0.5 rad/s
    yield "5e-324", arrives(found) or within(error, 1e-3)
    weight = subject.ask(Rod(gravity=1e308), rtol=1e-4)
    yield "overflow of products", ends(weight, STATUS.nonfinite_callback, words=("force[1]",))
    burst, jump = (
        plane(force=lambda t, q, v, since=since, late=late: np.array([0.0, -9.81 if t <= since else late]))
        for since, late in ((0.5, np.inf), (1.0, -1e12))
    )
    yield "overflow", ends(subject.ask(burst, rtol=1e-4), STATUS.nonfinite_callback, words=("force[1]",))
    yield "jump", ends(subject.ask(jump, rtol=1e-4), STATUS.step_too_small, STATUS.success)


P11 = tested(
    "P11",
    "a force that flips at a known time, declared as an event",
    "a step lands there; the closed solution",
    "tests/hht/test_event_changes.py",
)
FLIP = 0.4321  # [s]
REST = 1.0 - FLIP  # [s]
FLIPPED = 1.0 - 9.81 * FLIP**2 / 2 + (-9.81 * FLIP) * REST + 9.81 * REST**2 / 2  # [m]: at 1 s, from 1 m/s


@row("P12", "force flips undeclared; sign(v) sticking; tanh(v/1e-3)", "result or a bounded end", seconds=10.0)
def undeclared_flip(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row P12: force flips undeclared; sign(v) sticking; tanh(v/1e-3).

    Places at the end: 1/6 m, and after the flip; in under ten seconds each; sign(v) to 5e-3, the others to 1e-4.

    A prescribed step has no shorter one to be too small: where Newton's iteration finds no root of it, that is the status.
    One of 0.01 that knows of no flip is off by its length, and is asked for an end alone there.
    """
    fixed = "step" in request
    ended = (STATUS.newton_failed,) if fixed else (STATUS.step_too_small, STATUS.max_steps)
    cases: dict[str, tuple[Any, float, float]] = {
        "sign": (lambda t, q, v: -3.0 * np.sign(v), 1 / 6, 5e-3),
        "tanh": (lambda t, q, v: -3.0 * np.tanh(v / 1e-3), 1 / 6, 1e-4),
        "flip": (lambda t, q, v: np.array([9.81 if t > FLIP else -9.81]), FLIPPED, np.inf if fixed else 1e-4),
    }
    for case, (force, place, allowed) in cases.items():
        system = hb.NumpySystem(force=force)
        found = subject.ask(system, (0.0, 1.0), q0=[0.0], v0=[1.0], **request, max_num_steps=20_000)
        fault = ends(found, STATUS.success, *ended * (case != "tanh"))
        off = within(abs(found.q[-1, 0] - place), allowed, f"{case} off by")
        yield case, fault or (off if found.success else "")


@row("P13", "1e6 steps of a pendulum", "|g|, |G z| at most 1e-9; alpha = 0: energy bounded", lane=Lane.slow)
def million_steps(subject: Subject) -> Cases:
    """Yield the cases of row P13: 1e6 steps of a pendulum.

    IDA with GGL at 1e-6: 3.9e-9, 3.2e-8 and an energy off by 6.8e-5 m g L.  1e4 steps where they run in Python.
    """
    count = 10_000 if subject.engine == "python" else 1_000_000
    for alpha in ALPHAS:
        found = subject.hht(Rod(), alpha=alpha).solve((0.0, count * 1e-3), Q0, V0, steps=count)
        yield f"end alpha={alpha:g}", arrives(found)
        yield f"g alpha={alpha:g}", within(np.abs((found.q**2).sum(axis=1) - 1).max() / 2, 1e-9, "|g|")
        yield f"G z alpha={alpha:g}", within(np.abs((found.q * found.v).sum(axis=1)).max(), 1e-9, "|G z|")
        if alpha == 0.0:
            energy = (found.v**2).sum(axis=1) / 2 + 9.81 * found.q[:, 1]
            first, second = (np.abs(x - energy[0]).max() for x in np.array_split(energy, 2))
            yield "energy", within(second / first, 1.5, "energy's error in the second half over that in the first:")


P14 = tested(
    "P14",
    "a scene with a force alone, or a force and a constraint",
    "optional parts are not called (that calls are counted: claim counters/evaluations)",
    "tests/hht/test_physics.py",
    "tests/hht/test_absent_parts.py",
)
