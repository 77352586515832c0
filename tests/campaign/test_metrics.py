"""Metrics of hand-made solutions whose errors and drift are known."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench import Motion, NumpySystem, Problem, Request, Scales, Solution, Status, System, load_solver
from hhtbench.campaign import accuracy
from hhtbench.campaign.metrics import MOST_POINTS, measure, spans
from hhtbench.checks.drift import measure as drift
from hhtbench.protocol.evidence import plain
from hhtbench.solution.result import DenseOutput, Ends
from tests.adapters import scenes


class Circle(System):
    """A point that runs round the unit circle at speed one; no force but the constraint's, lam = 1/2."""

    def force(self, t: Any, q: Any, v: Any) -> Any:
        return 0 * q

    def constraint(self, t: Any, q: Any) -> Any:
        return jnp.stack([q @ q - 1])

    def energy(self, t: Any, q: Any, v: Any) -> Any:
        return v @ v / 2

    def invariants(self, t: Any, q: Any, v: Any) -> dict[str, Any]:
        return {"spin": q[0] * v[1] - q[1] * v[0]}


NUMPY_CIRCLE = NumpySystem(
    force=lambda t, q, v: 0 * q,
    constraint=lambda t, q: np.array([q @ q - 1]),
    energy=lambda t, q, v: v @ v / 2,
    invariants=lambda t, q, v: {"spin": q[0] * v[1] - q[1] * v[0]},
)


def exact(t: float) -> Motion:
    q, v = np.array([np.cos(t), np.sin(t)]), np.array([-np.sin(t), np.cos(t)])
    return Motion(q=q, v=v, lam=np.array([0.5]), mu=np.zeros(0))


def circle(**changes: Any) -> Problem:
    values: dict[str, Any] = {
        "name": "circle",
        "system": Circle(),
        "t_span": (0.0, 1.0),
        "q0": [1.0, 0.0],
        "v0": [0.0, 1.0],
        "exact": exact,
        "scales": Scales(q=2.0, v=np.array([1.0, 4.0]), lam=0.5),
        "observables": {"height": lambda t, q, v, lam: q[1]},
    }
    return Problem(**{**values, **changes})


def solution(
    t: Any = None,
    radius: float = 1.0,
    speed: float = 1.0,
    lam: float = 0.5,
    carried: float | None = 0.5,
    **changes: Any,
) -> Solution:
    times = np.linspace(0.0, 1.0, 11) if t is None else np.asarray(t)
    rows = [exact(time) for time in times]
    values: dict[str, Any] = {
        "t": times,
        "q": radius * np.array([row.q for row in rows]),
        "v": speed * np.array([row.v for row in rows]),
        "lam": np.full((times.size, 1), lam),
        "mu": np.zeros((times.size, 0)),
        "carried": None if carried is None else {"lam": np.full((times.size, 1), carried), "mu": np.zeros((times.size, 0))},
        "status": Status.success,
        "message": "made by hand",
    }
    return Solution(**{**values, **changes})


def test_an_exact_solution_has_neither_errors_nor_drift():
    found = measure(circle(), solution())
    assert found.note == ""
    errors, drift = found.metrics["errors"], found.metrics["drift"]
    assert (errors["against"], errors["points"], found.metrics["reached"]) == ("exact", 11, 1.0)
    assert all(errors[name]["max_scaled"] == 0.0 for name in ("q", "v", "lam"))
    assert "mu" not in errors
    for level in ("position", "velocity", "acceleration", "energy"):
        assert drift[level] < 1e-15
    assert drift["invariants"]["spin"] < 1e-15
    assert (drift["sampled"], drift["points"]) == ("rows", 11)


def test_curves_far_from_time_zero_keep_their_times():
    later = replace(circle(), t_span=(2000.0, 2000.05), exact=None, reference=None)
    times = np.linspace(2000.0, 2000.05, 51)
    series = measure(later, replace(solution(times), interpolant=None)).series
    assert len(set(series["multipliers"]["t"])) == 51
    assert len(set(series["drift"]["t"])) == 51


def test_errors_are_the_largest_component_over_its_scale_at_the_end_and_over_time():
    made = solution()
    q, v, lam = made.q.copy(), made.v.copy(), made.lam.copy()
    q[3, 1] += 0.5
    q[-1, 0] -= 0.02
    v[5, 0] += 0.1
    v[5, 1] += 0.2  # larger, but smaller over its scale of 4
    lam[-1] += 0.01
    errors = measure(circle(), replace(made, q=q, v=v, lam=lam)).metrics["errors"]
    assert errors["q"] == pytest.approx({"end": 0.02, "end_scaled": 0.01, "max": 0.5, "max_scaled": 0.25})
    assert errors["v"] == pytest.approx({"end": 0.0, "end_scaled": 0.0, "max": 0.2, "max_scaled": 0.1})
    assert errors["lam"] == pytest.approx({"end": 0.01, "end_scaled": 0.02, "max": 0.01, "max_scaled": 0.02})
    height = errors["observables"]["height"]
    assert height["max"] == pytest.approx(0.5)
    assert height["max_scaled"] == pytest.approx(0.5 / np.sin(1.0))


def test_without_an_exact_solution_the_rows_of_the_reference_count():
    true = exact(0.5)
    reference = {"t": [0.25, 0.5, 3.0], "q": [[9, 9], true.q, [9, 9]], "v": [[9, 9], true.v, [9, 9]], "digits": 8}
    problem = circle(exact=None, reference=reference)
    errors = measure(problem, solution(radius=1.1)).metrics["errors"]  # it has no row at 0.25 and 3
    assert (errors["against"], errors["digits"], errors["points"]) == ("reference", 8, 1)
    assert errors["q"]["max"] == pytest.approx(0.1 * np.max(np.abs(true.q)))
    assert errors["q"]["end"] is None
    assert "lam" not in errors
    assert "errors" not in measure(circle(exact=None), solution()).metrics


@pytest.mark.parametrize("system", [Circle(), NUMPY_CIRCLE], ids=["jax", "numpy"])
def test_drift_is_the_constraint_over_its_row_and_the_typical_sizes(system: Any):
    problem = circle(system=system, scales=Scales(q=2.0, v=4.0))
    drift = measure(problem, solution(t=[0.0, 0.25, 1.0], radius=1.1)).metrics["drift"]
    # g = 1.21 - 1 over sum |2 q_j| * 2, smallest where one coordinate is zero
    assert drift["position"] == pytest.approx(0.21 / (2 * 1.1 * 2), rel=1e-6)
    assert drift["position_absolute"] == pytest.approx(0.21)
    assert drift["velocity"] == pytest.approx(0.0, abs=1e-9)
    made = solution(t=[0.0, 0.25, 1.0])
    v = made.v.copy()
    v[0] += [0.3, 0.0]  # along the radius (1, 0): g_q v = 2 * 0.3, over 2 * 4
    drift = measure(problem, replace(made, v=v)).metrics["drift"]
    assert drift["velocity"] == pytest.approx(0.6 / 8, rel=1e-6)
    assert drift["velocity_absolute"] == pytest.approx(0.6, rel=1e-6)


def test_the_acceleration_level_is_judged_by_the_multipliers_that_the_solver_holds():
    """g'' = 2 q.vdot + 2 v.v with vdot = -2 lam q: 2 (1 - 2 lam), over 4 lam + 2; those recovered satisfy it always."""
    made = solution(t=[0.0, 1.0], lam=0.5, carried=0.75)
    drift = measure(circle(), made).metrics["drift"]
    assert drift["acceleration"] == pytest.approx(1.0 / (2 * 1.5 + 2))
    assert drift["acceleration_note"] is None
    assert drift["position"] < 1e-15
    wrong_rows = measure(circle(), solution(t=[0.0, 1.0], lam=0.75)).metrics["drift"]
    assert wrong_rows["acceleration"] < 1e-15


def test_an_instant_at_which_all_terms_vanish_does_not_make_a_small_imbalance_large():
    """At rest no multiplier is needed; one of 1e-6 is as large as all terms there, and nothing against those of the run."""
    made = solution(t=[0.0, 1.0])
    v, lam = np.array([made.v[0], [0.0, 0.0]]), np.array([[0.5], [1e-6]])
    drift = measure(circle(), replace(made, v=v, carried={"lam": lam, "mu": made.mu})).metrics["drift"]
    assert drift["acceleration"] == pytest.approx(4e-6 / (2 * 1.0 + 2))


class Flat(Circle):
    """The circle in space, held in its plane by a second constraint."""

    def constraint(self, t: Any, q: Any) -> Any:
        return jnp.stack([q[:2] @ q[:2] - 1, q[2]])


def test_a_row_that_holds_nothing_but_roundoff_is_not_said_to_be_violated():
    """Out of the plane there is no force: a multiplier of 1e-17 is all that the row holds, and all of it imbalance."""
    made, zero, lam = solution(), np.zeros((11, 1)), np.tile([0.5, 1e-17], (11, 1))
    wide = {"q": np.hstack([made.q, zero]), "v": np.hstack([made.v, zero]), "lam": lam}
    space = circle(system=Flat(), q0=[1.0, 0.0, 0.0], v0=[0.0, 1.0, 0.0], scales=Scales(q=2.0, v=4.0), exact=None)
    drift = measure(space, replace(made, **wide, carried={"lam": lam, "mu": made.mu})).metrics["drift"]
    assert drift["acceleration"] < 1e-14


def test_a_solver_without_multipliers_of_its_own_has_no_drift_at_the_acceleration_level():
    found = measure(circle(), solution(carried=None))
    drift = found.metrics["drift"]
    assert drift["acceleration"] is None
    assert drift["acceleration_note"] == "no multipliers of its own: zero by construction"
    assert "acceleration" not in found.series
    assert "lam_carried" not in found.metrics["errors"]


def ends(**changes: Any) -> Ends:
    made = solution(t=np.linspace(0, 1, 41), **changes)
    return Ends(t=made.t, q=made.q, v=made.v, carried=made.carried)


@pytest.mark.parametrize(("most", "points"), [(5000, 41), (10, 10)])
def test_the_acceleration_level_is_judged_at_every_step_or_at_some_of_many(monkeypatch, most: int, points: int):
    monkeypatch.setattr(drift, "MAX_OWN", most)
    found = measure(circle(), replace(solution(carried=0.5), ends=ends(carried=0.75)))
    assert found.metrics["drift"]["acceleration"] == pytest.approx(0.2)
    times = found.series["acceleration"]["t"]
    assert (len(times), times[0], times[-1]) == (points, 0.0, 1.0)


def test_the_multipliers_that_the_solver_holds_have_an_error_of_their_own():
    errors = measure(circle(), solution(lam=0.5, carried=0.75)).metrics["errors"]
    assert errors["lam"]["max"] == 0.0
    assert errors["lam_carried"] == pytest.approx({"end": 0.25, "end_scaled": 0.5, "max": 0.25, "max_scaled": 0.5})
    assert "mu_carried" not in errors


def test_stage_values_of_hht_are_judged_at_the_ends_of_its_steps():
    """Its rows lie between them, where it holds no multipliers.  Stage values are of order one (THEORY.md)."""
    scene, found = scenes.problem("mixed"), []
    for steps in (100, 200):
        made = load_solver("hht").solve(scene, Request(steps=steps, t_eval=[0.0, 0.013, 1.0]))
        assert made.carried is None
        found.append(measure(scene, made).metrics)
    first, second = (metrics["errors"] for metrics in found)
    assert first["lam_carried"]["max"] == pytest.approx(2 * second["lam_carried"]["max"], rel=0.1)
    assert first["lam"]["max"] < 0.1 * first["lam_carried"]["max"]
    assert found[0]["drift"]["acceleration"] == pytest.approx(2 * found[1]["drift"]["acceleration"], rel=0.1)
    every = load_solver("hht").solve(scene, Request(steps=100))
    np.testing.assert_array_equal(every.carried["lam"][1:], every.steps_data.lam_end)
    at_steps = measure(scene, every).metrics["drift"]["acceleration"]
    assert at_steps == pytest.approx(found[0]["drift"]["acceleration"], rel=1e-9)


def test_energy_and_invariants_change_relative_to_their_own_size():
    made = solution()
    v = made.v * np.linspace(1.0, 1.1, 11)[:, None]
    drift = measure(circle(), replace(made, v=v)).metrics["drift"]
    assert drift["energy"] == pytest.approx(0.21 / 1.21)  # over the largest kinetic energy
    assert drift["invariants"]["spin"] == pytest.approx(0.1)


def test_a_system_without_constraints_and_energy_has_null_for_each():
    problem = circle(system=NumpySystem(force=lambda t, q, v: 0 * q))
    drift = measure(problem, solution(lam=0.5)).metrics["drift"]
    assert [drift[name] for name in ("position", "velocity", "acceleration", "energy")] == [None] * 4
    assert drift["invariants"] == {}


@dataclass(frozen=True)
class Steps:
    """Dense output that is off the circle at one internal step only."""

    t: Any

    def __call__(self, t: Any) -> DenseOutput:
        rows = [exact(time) for time in t]
        radius = np.where(np.asarray(t) == 0.5, 1.2, 1.0)
        return DenseOutput(radius[:, None] * np.array([row.q for row in rows]), np.array([row.v for row in rows]))


def test_drift_is_measured_at_the_internal_steps_not_at_the_output_rows():
    ends = np.linspace(0.0, 1.0, 601)
    made = solution(t=[0.0, 1.0], interpolant=Steps(ends))
    problem = circle(scales=Scales(q=1.0))
    found = measure(problem, made)
    size = 2 * 1.2 * (np.cos(0.5) + np.sin(0.5))
    assert found.metrics["drift"]["position"] == pytest.approx(0.44 / size)
    assert (found.metrics["drift"]["sampled"], found.metrics["drift"]["points"]) == ("steps", 601)
    curve = found.series["drift"]
    assert len(curve["t"]) == MOST_POINTS
    assert max(curve["position"]) == pytest.approx(0.44 / size)  # thinning keeps the peak
    assert max(found.series["steps"]["h"]) == 0.00166667, "1 / 600 in the digits of a plot"


def test_ends_of_steps_that_a_solver_tells_show_the_drift():
    drift = measure(circle(), replace(solution(), ends=ends(radius=1.1))).metrics["drift"]
    assert (drift["sampled"], drift["points"]) == ("steps", 41)
    assert drift["position_absolute"] == pytest.approx(0.21)


def test_a_partial_solution_is_measured_as_far_as_it_reaches():
    made = solution(t=np.linspace(0, 0.5, 6), radius=1.1, status=Status.newton_failed)
    found = measure(circle(), made).metrics
    assert found["reached"] == 0.5
    assert found["errors"]["q"]["end"] is None
    assert found["errors"]["q"]["max"] == pytest.approx(0.1)
    nothing = measure(circle(), solution(t=[], lam=0.0, q=np.zeros((0, 2)), v=np.zeros((0, 2)))).metrics
    assert nothing == {"t_end": None, "reached": 0.0, "rows": 0}


def test_values_that_are_not_finite_become_null_and_end_the_drift_there():
    made = solution(radius=1.1)
    q = made.q.copy()
    q[7:] = np.nan
    found = measure(circle(), replace(made, q=q))
    json.dumps([found.metrics, found.series], allow_nan=False)
    assert found.metrics["errors"]["q"]["max"] is None
    assert found.metrics["drift"]["points"] == 7


def test_a_function_of_the_problem_that_raises_costs_its_own_part():
    def broken(t: float) -> Motion:
        raise RuntimeError("no idea")

    found = measure(circle(exact=broken), solution())
    assert found.note == "errors not measured: RuntimeError: no idea"
    assert found.metrics["drift"]["position"] < 1e-15


def test_a_backward_solution_reaches_its_end():
    made = solution(t=np.linspace(1.0, 0.0, 11))
    found = measure(circle(t_span=(1.0, 0.0), q0=exact(1.0).q, v0=exact(1.0).v), made).metrics
    assert found["reached"] == 1.0
    assert found["errors"]["q"]["end"] == 0.0


def test_thinning_keeps_the_largest_and_the_last():
    t = np.arange(1000.0)
    curve = spans(t, {"x": np.where(t == 333, 7.0, 1.0)})
    assert len(curve["t"]) == MOST_POINTS
    assert curve["x"].max() == 7.0
    assert curve["t"][-1] == 999
    assert plain({"a": np.array([np.inf, 1.0])}) == {"a": [None, 1.0]}


def damped(c: float = 0.3, taken: float = 0.3) -> Problem:
    """A mass on a spring with a damper: its energy falls by what the damper takes."""
    system = NumpySystem(
        force=lambda t, q, v: -q - c * v,
        energy=lambda t, q, v: v @ v / 2 + q @ q / 2,
        power=lambda t, q, v, lam, mu: -taken * v @ v,
    )
    return Problem(name="damped", system=system, t_span=(0.0, 10.0), q0=[1.0], v0=[0.0])


@pytest.mark.parametrize("rows", [1, 600], ids=["the start alone", "more than a chunk"])
def test_without_constraints_only_the_energy_can_drift(rows: int):
    class Spring(System):
        def force(self, t: Any, q: Any, v: Any) -> Any:
            return -q

        def energy(self, t: Any, q: Any, v: Any) -> Any:
            return (v @ v + q @ q) / 2

    t = np.linspace(0.0, 1.0, rows)
    states = {"t": t, "q": np.cos(t)[:, None], "v": -1.1 * np.sin(t)[:, None]}
    free = Problem(name="free", system=Spring(), t_span=(0.0, 1.0), q0=[1.0], v0=[0.0])
    none = np.zeros((rows, 0))
    made = Solution(**states, lam=none, mu=none, status=Status.success, message="made by hand")
    found: Any = drift.measure_drift(free, made)
    assert (found.position, found.velocity, found.acceleration) == (None, None, None)
    np.testing.assert_allclose(found.energy, 0.21 * np.sin(t) ** 2, rtol=1e-12, atol=1e-15)


def test_the_energy_that_a_damper_takes_is_no_drift():
    """Nine tenths of the energy go into the damper; Radau keeps the balance to its tolerance."""
    solved = load_solver("scipy(method=Radau)").solve(damped(), Request(rtol=1e-8))
    assert solved.v[-1] @ solved.v[-1] + solved.q[-1] @ solved.q[-1] < 0.1
    drift = measure(damped(), solved).metrics["drift"]
    assert drift["energy"] < 1e-6
    wrong = measure(damped(taken=0.33), solved).metrics["drift"]
    assert wrong["energy"] == pytest.approx(0.1, rel=0.1), "a tenth of what the damper takes is not accounted for"


def test_a_balance_that_the_steps_do_not_resolve_is_not_reported():
    """Six states for ten seconds: the integral of the power between them is anybody's guess."""
    solved = load_solver("scipy(method=Radau)").solve(damped(), Request(rtol=1e-8, t_eval=np.linspace(0, 10, 6)))
    drift = measure(damped(), solved).metrics["drift"]
    assert drift["energy"] is None
    assert drift["energy_note"].startswith("the integral of the power over the steps is known to ")


@pytest.mark.parametrize("kind", ["jax", "numpy"])
def test_the_power_of_a_moving_constraint_comes_from_its_multiplier(kind: str):
    """A point held at x = t^2: the drive's power is m x'' x' = 2 * 2 t, the kinetic energy 2 t^2."""
    parts: dict[str, Any] = {
        "force": lambda t, q, v: 0 * q,
        "constraint": lambda t, q: q - t**2,
        "energy": lambda t, q, v: v @ v / 2,
        "power": lambda t, q, v, lam, mu: -lam[0] * 2 * t,
    }
    held = type("Held", (System,), {name: (lambda self, *a, f=f: f(*a)) for name, f in parts.items()})()
    system = held if kind == "jax" else NumpySystem(**parts)
    problem = Problem(name="held", system=system, t_span=(0.0, 1.0), q0=[0.0], v0=[0.0])
    t = np.linspace(0.0, 1.0, 41)
    lam = np.full((41, 1), 7.0)  # those of the rows are not asked
    made = solution(t=t, q=t[:, None] ** 2, v=2 * t[:, None], lam=0.0, carried=None)
    drift = measure(problem, replace(made, lam=lam)).metrics["drift"]
    assert drift["energy"] < 1e-6


def test_an_exact_solution_is_computed_at_some_rows_from_the_first_to_the_last(monkeypatch):
    """A run of a million steps is compared at two thousand of them, and at its first rows."""
    monkeypatch.setattr(accuracy, "MOST_EXACT", 10)
    monkeypatch.setattr(accuracy, "FIRST", 3)
    asked: list[float] = []

    def noted(t: float) -> Motion:
        asked.append(t)
        return exact(t)

    found = measure(circle(exact=noted), solution(t=np.linspace(0, 1, 41), lam=0.5, carried=None)).metrics["errors"]
    assert (len(asked), asked[:3], asked[-1]) == (12, [0.0, 1 / 40, 2 / 40], 1.0)
    assert found["points"] == 12
    assert found["lam"]["end"] == 0.0
