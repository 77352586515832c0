"""Constraint levels at every step, orders of the multipliers, velocity-level and mixed constraints, Andrews' mechanism."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hhtbench.evidence import Row
from hhtbench.protocol import Problem
from solvers.hht.solver import HHT
from solvers.hht.verify.measure import Case, Progress, below_row, integrate, known_at, order_row, scaled_drift, slope
from solvers.hht.verify.measure import errors as measure_errors
from solvers.hht.verify.orders import MARGIN, NAMES, measured_orders

HELD = 1e-12  # scaled residual that counts as roundoff
FIRST = 0.1  # margin of the first-order stage multipliers


def drift(case: Case, steps: int, progress: Progress) -> list[Row]:
    """Largest scaled residual of both levels over all steps, for three alphas and three choices of the reaction."""
    rows = []
    options: list[dict[str, Any]] = [{"alpha": a} for a in (0.0, -0.05, -1.0 / 3.0)]
    if case.exact(case.t_end).lam.size:
        options += [{"alpha": -0.15, "b": 0.3, "reaction": r} for r in ("implicit", "predictor")]
        options.append({"alpha": -0.15, "reaction": "midpoint"})
    for method in options:
        progress(f"drift: {case.name} {method}")
        problem = case.problem
        span, guess = (problem.t_span[0], case.t_end), problem.lam_guess
        solution = HHT(problem.system, **method).solve(span, problem.q0, problem.v0, steps=steps, lam_guess=guess)
        if not solution.success:
            raise RuntimeError(f"{case.name}: {solution.message}")
        position, velocity = scaled_drift(case, solution)
        name = ", ".join(f"{k} = {NAMES.get(v, v) if k == 'alpha' else v}" for k, v in method.items())
        claim = f"{name}: largest scaled residual of both constraint levels over {steps} steps"
        rows.append(below_row(f"drift/{case.name}", claim, max(position, velocity), HELD))
    return rows


def multipliers(case: Case, refinements: list[int], progress: Progress) -> list[Row]:
    """Orders of the stage multipliers, of their mean at the midpoint and of the recovered ones."""
    rows = []
    for alpha in (0.0, -0.3):
        progress(f"multipliers: {case.name} alpha = {NAMES[alpha]}")
        method = {"alpha": alpha, "b": 0.0, "reaction": "implicit"}
        keys = ("lam_start", "lam_end", "lam_mean", "lam")
        rms, _ = measured_orders(case, list(refinements), method, keys)
        name, id = f"alpha = {NAMES[alpha]}", f"multipliers/{case.name}"
        stages = {key: rms[key] for key in ("lam_start", "lam_end")}
        rows.append(order_row(id, f"{name}: stage multipliers at t0 and t1 (RMS order)", stages, 1.0, FIRST))
        rows.append(order_row(id, f"{name}: their mean at the midpoint", {"mean": rms["lam_mean"]}, 2.0, MARGIN))
        rows.append(order_row(id, f"{name}: recovered from the acceleration level", {"lam": rms["lam"]}, 2.0, MARGIN))
    return rows


def kinds(case: Case, refinements: list[int], label: str, progress: Progress) -> list[Row]:
    """Order two of q, v and of the recovered multipliers for velocity-level or mixed constraints."""
    rows = []
    keys = ("q", "v", "mu") + (("lam",) if case.exact(case.t_end).lam.size else ())
    for alpha in (0.0, -0.05, -0.3):
        progress(f"{label}: {case.name} alpha = {NAMES[alpha]}")
        rms, _ = measured_orders(case, list(refinements), {"alpha": alpha, "b": 0.0, "reaction": "implicit"}, keys)
        rows.append(order_row(f"{label}/{case.name}", f"alpha = {NAMES[alpha]}, b = 0: RMS orders", rms, 2.0, MARGIN))
    if "lam" in keys:
        for method in (
            {"alpha": -0.15, "b": 0.3, "reaction": "implicit"},
            {"alpha": -0.15, "b": 0.3, "reaction": "predictor"},
        ):
            progress(f"{label}: {case.name} {method}")
            rms, _ = measured_orders(case, list(refinements), method, keys)
            name = f"alpha = -0.15, b = 0.3, {method['reaction']}"
            rows.append(order_row(f"{label}/{case.name}", f"{name}: RMS orders", rms, 2.0, MARGIN))
    return rows


def unconstrained(case: Case, refinements: list[int], progress: Progress) -> list[Row]:
    """Plain HHT-alpha on the oscillator chain: order two of q and v."""
    steps = [case.t_end / n for n in refinements]
    rows = []
    for alpha in (0.0, -0.3):
        progress(f"unconstrained: alpha = {NAMES[alpha]}")
        found = [measure_errors(case, integrate(case, n, alpha=alpha), alpha).rms for n in refinements]
        orders = {key: slope(steps, [x[key] for x in found]) for key in ("q", "v", "a")}
        rows.append(order_row(f"unconstrained/{case.name}", f"alpha = {NAMES[alpha]}: RMS orders", orders, 2.0, MARGIN))
    return rows


def andrews(problem: Problem, progress: Progress) -> tuple[list[Row], list[Row]]:
    """Andrews' mechanism at t = 0.03 with 12,000 steps against the reference; drift over the same run."""
    progress("andrews: 12,000 steps")
    span = (0.0, 0.03)
    solution = HHT(problem.system).solve(span, problem.q0, problem.v0, steps=12_000)
    if not solution.success:
        raise RuntimeError(f"andrews: {solution.message}")
    rows = []
    for name, found in (("q", solution.q[-1]), ("v", solution.v[-1])):
        wanted = known_at(problem, name, 0.03)
        worst = float(np.max(np.abs(found - wanted)) / np.max(np.abs(wanted)))
        rows.append(below_row("andrews", f"{name}(0.03) with 12,000 steps: error over max|{name}|", worst, 1e-6))
    case = Case(name="andrews", problem=replace(problem, exact=None), t_end=0.03, times=1, exact=None, force=None)  # type: ignore[arg-type]
    position, velocity = scaled_drift(case, solution)
    claim = "12,000 steps: largest scaled residual of both constraint levels"
    return rows, [below_row("drift/andrews", claim, max(position, velocity), HELD)]
