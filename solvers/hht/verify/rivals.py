"""``hhtbench verify rivals``: what the field's own methods keep of their published orders, beside the extended HHT."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hhtbench import load_problem
from hhtbench.arguments import Matrix, Vector
from hhtbench.evidence import Evidence, Row
from hhtbench.protocol import Problem
from hhtbench.result import Solution
from solvers.hht.equations.generalised_alpha import GeneralisedAlpha
from solvers.hht.rivals import GeneralisedAlphaIntegrator, HHTI3Integrator, RattleIntegrator
from solvers.hht.solver import HHT
from solvers.hht.verify.measure import guesses, known_at, scaled_drift, solved
from solvers.hht.verify.study import Method, Progress, Study, below_row, order_row, shown_row, slope, verify
from solvers.hht.verify.vibration import make_scene, measured_matrix, radius, spectrum, swing_of

METHODS: dict[str, tuple[type[HHT], Method]] = {
    "hht": (HHT, {}),
    "ggl": (GeneralisedAlphaIntegrator, {}),
    "extended": (GeneralisedAlphaIntegrator, {"form": "extended"}),
    "index3": (GeneralisedAlphaIntegrator, {"form": "index3"}),
    "hht_i3": (HHTI3Integrator, {}),
    "rattle": (RattleIntegrator, {}),
    "undamped hht": (HHT, {"alpha": 0.0, "b": 0.0}),
    "ggl from v'": (GeneralisedAlphaIntegrator, {"start": "f0"}),
    "index3 from v'": (GeneralisedAlphaIntegrator, {"form": "index3", "start": "f0"}),
    "index3 corrected": (GeneralisedAlphaIntegrator, {"form": "index3", "start": "corrected"}),
    "ggl not rescaled": (GeneralisedAlphaIntegrator, {"rescale_a": False}),
    "index3 not rescaled": (GeneralisedAlphaIntegrator, {"form": "index3", "rescale_a": False}),
}
ALL = tuple(METHODS)[:6]
BOTH_LEVELS, POSITIONS = ("hht", "ggl", "extended", "rattle"), ("index3", "hht_i3")
BEGIN_WELL = ("hht", "ggl", "extended", "index3 corrected", "rattle")
BEGIN_BADLY = ("ggl from v'", "index3", "index3 from v'", "hht_i3")
QUANTITIES = ("q", "v", "lam")
Names = tuple[str, ...]
MARGIN = 0.1  # of an order
ROUNDOFF = 1e-12  # scaled, of a level that a method holds
SOME = 5  # first and last steps whose largest error counts: errors of multipliers may alternate
RATES = (0.0, 0.3, 0.5, 0.8, 1.0)  # rho_inf
FREQUENCIES = tuple(np.logspace(-2, 4, 25).tolist())  # w h
SIMPLE = 1e-10  # of a spectral radius: roundoff of nearly double roots
LEADING = 0.01  # relative: what the first term of a series leaves out at w h = 0.1
LIMIT = 1e-5  # the same of what is a double root at infinity


@dataclass(frozen=True)
class Case:
    """A problem between two times [s] at which its motion is known, and numbers of steps."""

    name: str
    span: tuple[float, float]
    counts: tuple[int, ...]

    def __str__(self) -> str:
        return self.name

    @property
    def problem(self) -> Problem:
        """As the library has it."""
        return load_problem(self.name)

    def known(self, t: float) -> dict[str, Vector]:
        """q, v and lam at ``t`` [s], by the closed solution or a row of the reference."""
        p = self.problem
        at = p.exact(t) if p.exact else None
        return {name: known_at(p, name, t) if at is None else np.asarray(getattr(at, name)) for name in QUANTITIES}


SWING = Case("simple_pendulum", (0.3, 1.3), (200, 400, 800))
CASES = (
    SWING,
    Case("heavy_top", (0.0, 0.1), (200, 400, 800)),  # its mass varies
    Case("stiff_spring_pendulum(stiffness=1e4)", (0.0, 1.0), (2000, 4000, 8000)),
    Case("sundials_slider_crank", (0.0, 10.0), (1000, 2000, 4000)),  # with a damper and a drive
)
KNIFE = Case("knife_edge", (0.0, 1.0), (200, 400, 800))  # its constraint holds a velocity
FIRST_ORDER = {"heavy_top": ("hht_i3",)}  # M a at one end and forces at two are no equation of order two where M varies


def verify_rivals(progress: Progress | None = None, jobs: int = 1) -> Evidence:
    """Orders, drift, first steps and changing steps of generalised-alpha, HHT-I3 and RATTLE; a minute on two cores."""
    return verify("The field's own methods beside the extended HHT", STUDIES, progress, jobs)


def integrate(case: Case, method: str, steps: Vector) -> Solution:
    """``case`` from its start by ``steps`` (k,) [s]."""
    kind, options = METHODS[method]
    p, t0 = case.problem, case.span[0]
    q, v = (p.q0, p.v0) if t0 == p.t_span[0] else (case.known(t0)[name] for name in ("q", "v"))
    return solved(f"{case} by {method}", kind(p.system, **options), (t0, t0 + steps.sum()), q, v, steps=steps, **guesses(p))


def lengths(case: Case, count: int, *, alternating: bool = False) -> Vector:
    """``count`` steps to the end of ``case``, equal ones or 1:2, and one beyond."""
    h = (case.span[1] - case.span[0]) / count
    steps = np.tile([2 * h / 3, 4 * h / 3], count // 2) if alternating else np.full(count, h)
    return np.append(steps, steps[0])


def errors(case: Case, solution: Solution, steps: Iterable[int]) -> dict[str, float]:
    """The largest 2-norms of the errors of q, v and lam after each of ``steps``, numbers of steps.

    Multipliers at the ends of steps lie between those of two stages, which makes them of second order.
    """
    data: Any = solution.steps_data
    before, after = data.h[:-1, None], data.h[1:, None]
    lam = (after * data.lam_end[:-1] + before * data.lam_start[1:]) / (before + after)
    worst = dict.fromkeys(QUANTITIES, 0.0)
    for k in steps:
        t = float(solution.t[k])
        known = case.known(case.span[1] if np.isclose(t, case.span[1], rtol=1e-12) else t)
        found = {"q": solution.q[k], "v": solution.v[k], "lam": lam[k - 1]}
        worst = {name: max(size, float(np.linalg.norm(found[name] - known[name]))) for name, size in worst.items()}
    return worst


def orders(case: Case, method: str, names: Names = QUANTITIES, *, alternating: bool = False) -> dict[str, float]:
    """Of ``names`` at the end of ``case``, by halving the steps; ``alternating``: 1:2, and over the last steps."""
    found = []
    for count in case.counts:
        solution = integrate(case, method, lengths(case, count, alternating=alternating))
        found.append(errors(case, solution, range(count - SOME + 1 if alternating else count, count + 1)))
    return {name: slope([1.0 / count for count in case.counts], [at[name] for at in found]) for name in names}


def constant_steps(case: Case, methods: Names, names: Names = QUANTITIES) -> list[Row]:
    """Orders of ``methods`` with constant steps."""
    found, rows = {method: orders(case, method, names) for method in methods}, []
    for name in names:
        of = {method: at[name] for method, at in found.items()}
        slow = {method: of.pop(method) for method in FIRST_ORDER.get(case.name, ())}
        claim = f"{case}, constant steps: order of {name} at t = {case.span[1]:g}"
        rows.append(order_row(f"order/{case}/{name}", claim, of, 2.0, MARGIN))
        if slow:
            one = f"{claim}; its equations are of order one there"
            rows.append(order_row(f"order/{case}/{name}", one, slow, 1.0, MARGIN))
    return rows


def drift(case: Case) -> list[Row]:
    """Both constraint levels with constant steps: held to roundoff, or left to the method's order."""
    steps = [lengths(case, count) for count in case.counts]
    found = {m: [scaled_drift(case.problem, integrate(case, m, each)) for each in steps] for m in ALL}
    position = max(at[0] for each in found.values() for at in each)
    velocity = max(at[1] for method in BOTH_LEVELS for at in found[method])
    left, id = {m: slope([1.0 / k for k in case.counts], [at[1] for at in found[m]]) for m in POSITIONS}, f"drift/{case}"
    return [
        below_row(id, f"{case}: position residual of all methods", position, ROUNDOFF),
        below_row(id, f"{case}: velocity residual of {', '.join(BOTH_LEVELS)}", velocity, ROUNDOFF),
        shown_row(id, f"{case}: order of the velocity residual where positions alone are held", left),
    ]


def first_steps(case: Case) -> list[Row]:
    """Orders of the multipliers' worst error in the first steps, by how the start is made."""
    of, sizes = dict[str, float](), list[str]()
    for method in (*BEGIN_WELL, *BEGIN_BADLY):
        runs = [integrate(case, method, lengths(case, count)[: SOME + 1]) for count in case.counts]
        worst = [errors(case, solution, range(1, SOME + 1))["lam"] for solution in runs]
        of[method] = slope([1.0 / count for count in case.counts], worst)
        sizes.append(f"{method} {worst[-1]:.1e}")
    claim, id = f"{case} from t = {case.span[0]:g}: worst error of lam in the first {SOME} steps", f"first/{case}"
    return [
        order_row(id, f"{claim}, its order", {method: of[method] for method in BEGIN_WELL}, 2.0, MARGIN),
        order_row(id, f"{claim}, its order", {method: of[method] for method in BEGIN_BADLY}, 1.0, MARGIN),
        shown_row(id, f"{claim}, {case.counts[-1]} steps a span", ", ".join(sizes)),
    ]


def changing_steps(case: Case) -> list[Row]:
    """Orders on steps 1:2; index 3 keeps none of its multipliers, whatever is rescaled."""
    found = {m: orders(case, m, alternating=True) for m in (*ALL, "ggl not rescaled", "index3 not rescaled")}
    rows = []
    for name in QUANTITIES:
        of = {method: at[name] for method, at in found.items()}
        held = {method: of.pop(method) for method in BOTH_LEVELS}
        claim = f"{case}, steps 1:2: order of {name}"
        rows.append(order_row(f"changing/{case}/{name}", claim, held, 2.0, MARGIN))
        rows.append(shown_row(f"changing/{case}/{name}", f"{claim}, not made for them", of))
    return rows


def same_as_hht(case: Case) -> Row:
    """RATTLE and HHT with alpha = 0, b = 0 under a constant force."""
    steps = lengths(case, case.counts[0])
    first, second = (integrate(case, method, steps) for method in ("undamped hht", "rattle"))
    most = max(float(np.abs(first.q - second.q).max()), float(np.abs(first.v - second.v).max()))
    claim = f"{case}: q, v of RATTLE less those of HHT with alpha = 0, b = 0"
    return below_row("rattle/constant force", claim, most, ROUNDOFF)


def leapfrog() -> Row:
    """Period errors where the force depends on the position: those of the leapfrog and of the trapezoidal rule."""
    scene, x = make_scene("oscillator"), 0.1
    of_rattle = swing_of(spectrum(measured_matrix(scene, {}, x, kind=RattleIntegrator)), x).elongation
    of_hht = swing_of(spectrum(measured_matrix(scene, {"alpha": 0.0}, x)), x).elongation
    return Row(
        id="rattle/oscillator",
        claim=f"oscillator, w h = {x:g}: too long a period by, over (w h)^2/24: RATTLE, HHT with alpha = 0",
        measured=f"{of_rattle / x**2 * 24:.4f}, {of_hht / x**2 * 24:.4f}",
        bound=f"-1, 2 +- {LEADING:.0%}",
        passed=abs(of_rattle / x**2 * 24 + 1.0) < LEADING and abs(of_hht / x**2 * 12 - 1.0) < LEADING,
    )


def vibrations(rho: float, form: str) -> list[Row]:
    """The spectral radius of generalised-alpha on the oscillator, against the closed form and its limit rho_inf."""
    scene, own, options = make_scene("oscillator"), GeneralisedAlphaIntegrator, {"rho_inf": rho, "form": form}
    worst = max(
        abs(radius(spectrum(measured_matrix(scene, options, x, kind=own))) - radius(spectrum(closed_form(rho, x))))
        for x in FREQUENCIES
    )
    limit = abs(radius(spectrum(measured_matrix(scene, options, 1e8, kind=own))) - rho)
    claim = f"generalised-alpha, {form}, rho_inf = {rho:g}, oscillator: spectral radius"
    return [
        below_row("radius", f"{claim} up to w h = {FREQUENCIES[-1]:g} less that of the closed form", worst, SIMPLE),
        below_row("radius", f"{claim} at w h = 1e8 less rho_inf", limit, LIMIT),
    ]


def closed_form(rho: float, frequency: float) -> Matrix:
    """The (3, 3) map of (y, h y', h^2 a) of one step for y'' = -w^2 y, (H36) and (H39), with v' = -w^2 y at both ends."""
    c, square = GeneralisedAlpha(rho_inf=rho, form="ggl"), frequency**2
    end = np.array([[1.0, 0.0, -c.beta], [0.0, 1.0, -c.gamma], [(1.0 - c.alpha_f) * square, 0.0, 1.0 - c.alpha_m]])
    begin = np.array([[1.0, 1.0, 0.5 - c.beta], [0.0, 1.0, 1.0 - c.gamma], [-c.alpha_f * square, 0.0, -c.alpha_m]])
    return np.linalg.solve(end, begin)


STUDIES: tuple[Study, ...] = (
    *((constant_steps, case, ALL) for case in CASES),
    (constant_steps, KNIFE, ("hht", "extended"), ("q", "v")),
    *((drift, case) for case in CASES),
    (first_steps, SWING),
    (changing_steps, replace(SWING, counts=(800, 1600, 3200))),
    (same_as_hht, SWING),
    (leapfrog,),
    *((vibrations, rho, form) for rho in RATES for form in ("ggl", "extended")),
)
