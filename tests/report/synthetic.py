"""Seeded rows of 6 problems x 15 solvers x 5 tolerances with every kind of outcome; power laws known in advance."""

from __future__ import annotations

import math
import random

from hhtbench.campaign.store.rows import RunRow

# name: position constraints, velocity constraints, span [s], how well it is known
PROBLEMS = {
    "andrews": (True, False, 0.03, ("reference", 12)),
    "jay_negrut_pendulum": (True, False, 2.0, ("exact", None)),
    "jay_negrut_test1": (True, False, 1.0, ("exact", None)),
    "knife_edge": (False, True, 4.0, ("exact", None)),
    "oscillator_chain(n=10)": (False, False, 10.0, ("reference", 4)),
    "planar_chain(n_links=4)": (True, False, 1.0, None),
}
# name: order of error against evaluations, seconds an evaluation, drift of position (None: as the error), factor of error
SOLVERS = {
    "hht(alpha=0)": (2, 2e-6, 1e-15, 1.0),
    "hht(alpha=-0.1)": (2, 2e-6, 2e-15, 1.5),
    "hht(rho_inf=0.5)": (2, 2e-6, 1e-15, 3.0),
    "hht(alpha=-0.1, b=1)": (2, 2e-6, 1e-15, 2.0),
    "ida(form='ggl')": (4, 2e-5, 5e-9, 1.0),
    "ida(form='index1')": (4, 2e-5, None, 1.0),
    "ida(form='index2')": (3, 2e-5, 1e-7, 5.0),
    "ida(form='integrated')": (4, 2e-5, 1e-8, 1.0),
    "cvode(form='ode', method='adams')": (6, 2e-5, None, 1.0),
    "cvode(form='ode', method='bdf')": (4, 2e-5, None, 2.0),
    "scipy(method='DOP853')": (8, 4e-5, None, 0.3),
    "scipy(method='LSODA')": (5, 4e-5, None, 1.0),
    "scipy(method='Radau')": (5, 9e-5, None, 1.0),
    "diffrax(method='Dopri8')": (8, 5e-5, None, 0.5),
    "diffrax(method='Kvaerno5')": (5, 2e-5, None, 1.0),
}
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
MACHINE = {"python": "3.11.9", "system": "Linux", "machine": "x86_64", "processor": "<Test> & Co", "cores": 2, "jax": "0.10"}


def failure(problem, solver, rtol):
    """Status and message of the cells that fail, or None."""
    if problem == "oscillator_chain(n=10)" and "form=" in solver and "ida" in solver:
        return "declined", "the form needs constraints and the system has none"
    if problem == "andrews" and "index2" in solver and rtol < 1e-5:
        return "newton_failed", f"no convergence at t = {0.01 * rtol**0.1:.3g}; take a smaller step"
    if problem == "andrews" and "Radau" in solver and rtol < 1e-6:
        return "deadline", "the budget of 20 seconds is used up"
    if problem == "knife_edge" and "LSODA" in solver:
        return "crashed", "the worker died with signal 11"
    if problem == "planar_chain(n_links=4)" and solver == "hht(rho_inf=0.5)" and rtol == 1e-7:
        return "unreliable", "position drift | is 1.0"
    return None


def row(problem, solver, rtol, noise=lambda: 1.0, **changes):
    """One cell."""
    position, velocity, span, known = PROBLEMS.get(problem, (True, False, 1.0, ("exact", None)))
    order, seconds, held, worse = SOLVERS.get(solver, (2, 1e-6, None, 1.0))
    failed = failure(problem, solver, rtol)
    values = {
        "key": f"{problem}|{solver}|{rtol}",
        "problem": problem,
        "solver": solver,
        "request": {"rtol": rtol, "atol": None, "step": None, "steps": None, "outputs": 51, "max_seconds": 20.0},
        "status": failed[0] if failed else "success",
        "message": failed[1] if failed else "the end of the interval was reached",
        "environment": MACHINE,
        "created": "2026-01-02T03:04:05+00:00",
    }
    if failed and failed[0] in ("declined", "crashed"):
        return RunRow(**values)
    error = 10 * worse * rtol * noise()
    cheap = 0.05 if problem.startswith("planar") and solver.startswith("hht") else 1.0
    evaluations = max(1, round(30 * error ** (-1 / order) * cheap * noise()))
    drift = (held or error / 30) * noise()
    reached = 0.4 if failed else 1.0
    solve = evaluations * seconds * noise() if not failed or failed[0] != "deadline" else 20.0
    values["metrics"] = _metrics(error, drift, span * reached, reached, (position, velocity, known))
    values["metrics"]["call"] = {"operations": 250, "of_residual": 100} if "cvode" in solver or "scipy" in solver else None
    values["series"] = _series(drift, span * reached, (position, velocity), noise)
    values["counters"] = {
        "steps_accepted": evaluations // 3,
        "residual_evaluations": evaluations,
        "jacobian_evaluations": None if "diffrax" in solver else evaluations // 10,
        "provenance": "counted",
    }
    best = None if failed else solve
    values["timing"] = {"compile_s": 1.5, "solve_s": solve * 1.2, "best_s": best, "median_s": best, "repeats": 3}
    if best is not None:
        values["timing"] |= {"wall_s": best / 0.9, "solves": 3, "load": 1.0, "disturbed": solver == "scipy(method='Radau')"}
    return RunRow(**values | changes)


def _metrics(error, drift, t_end, reached, kind):
    position, velocity, known = kind
    tags = ["damped"] if position or velocity else ["unconstrained", "stiff"]
    entry = {"end": error, "end_scaled": error, "max": error, "max_scaled": error}
    sizes = {"n": 3, "m": int(position), "p": int(velocity)}
    metrics = {"t_end": t_end, "reached": reached, "rows": 51, "system": {**sizes, "tags": tags}}
    metrics["drift"] = {
        "position": drift if position else None,
        "position_absolute": 2 * drift if position else None,
        "velocity": drift * 30 if position or velocity else None,
        "acceleration": drift * 100 if position or velocity else None,
        "energy": error / 10,
        "invariants": {"momentum": error / 20},
        "sampled": "steps",
        "points": 300,
    }
    if known:
        metrics["errors"] = {"against": known[0], "digits": known[1], "points": 1, "q": entry, "observables": {}}
        metrics["errors"]["v"] = {name: 3 * value for name, value in entry.items()}
        if position:
            metrics["errors"]["lam"] = {name: 20 * value for name, value in entry.items()}
        if velocity:
            metrics["errors"]["mu"] = {name: 20 * value for name, value in entry.items()}
    return metrics


def _series(drift, t_end, kind, noise):
    position, velocity = kind
    t = [t_end * index / 199 for index in range(200)]
    growth = [drift * (0.02 + 0.98 * math.sqrt(index / 199)) * min(1.0, noise()) for index in range(200)]
    series = {"t": t}
    if position:
        series["position"] = growth
    if position or velocity:
        series["velocity"] = [30 * value for value in growth]
    series["energy"] = [3 * value for value in growth]
    series["invariants"] = {"momentum": [5 * value for value in growth]}
    lam = [[40 * math.cos(time / t_end), 7.0, -0.1, 0.0] if position else [] for time in t[::4]]
    mu = [[-3.0 * time] if velocity else [] for time in t[::4]]
    found = {"drift": series, "multipliers": {"t": t[::4], "lam": lam, "mu": mu}}
    if position or velocity:
        found["acceleration"] = {"t": t[::4], "value": [100 * value for value in growth[::4]]}
    return found


def rows(seed=7):
    """The whole campaign, always the same for one seed."""
    source = random.Random(seed)

    def noise():
        return math.exp(source.gauss(0.0, 0.15))

    return [row(p, s, rtol, noise) for p in PROBLEMS for s in SOLVERS for rtol in TOLERANCES]
