"""``hhtbench verify rivals``: what the field's own methods keep of their published orders, beside the extended HHT."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.evidence import Evidence, Row
from hhtbench.result import Solution
from solvers.hht.equations.generalised_alpha import GeneralisedAlpha
from solvers.hht.rivals import GeneralisedAlphaIntegrator, HHTI3Integrator, RattleIntegrator
from solvers.hht.solver import HHT
from solvers.hht.verify.damping import make_scene, measured_matrix, radius, spectrum, swing_of
from solvers.hht.verify.measure import Case, errors, integrate, scaled_drift
from solvers.hht.verify.measure import alternating as pairs
from solvers.hht.verify.study import Method, Progress, Study, below_row, judged_row, order_row, shown_row, slope, verify

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


SWING = Case("simple_pendulum", 1.3, t_start=0.3, counts=(200, 400, 800))
CASES = (
    SWING,
    Case("heavy_top", 0.1, counts=(200, 400, 800)),  # its mass varies
    Case("stiff_spring_pendulum(stiffness=1e4)", 1.0, counts=(2000, 4000, 8000)),
    Case("sundials_slider_crank", 10.0, counts=(1000, 2000, 4000)),  # with a damper and a drive
)
KNIFE = Case("knife_edge", 1.0, counts=(200, 400, 800))  # its constraint holds a velocity
FIRST_ORDER = {"heavy_top": ("hht_i3",)}  # M a at one end and forces at two are no equation of order two where M varies


def verify_rivals(progress: Progress | None = None, jobs: int = 1) -> Evidence:
    """Orders, drift, first steps and changing steps of generalised-alpha, HHT-I3 and RATTLE; a minute on two cores."""
    return verify("The field's own methods beside the extended HHT", STUDIES, progress, jobs)


def integrated(case: Case, method: str, steps: Vector) -> Solution:
    """``case`` from its start by ``steps`` (k,) [s]."""
    kind, options = METHODS[method]
    return integrate(case, steps, kind, **options)


def lengths(case: Case, count: int, *, alternating: bool = False) -> Vector:
    """``count`` steps to the end of ``case``, equal ones or 1:2, and one beyond."""
    steps = pairs(case, count // 2) if alternating else np.full(count, (case.t_end - case.t_start) / count)
    return np.append(steps, steps[0])


def worst(case: Case, solution: Solution, name: str, ends: Iterable[int]) -> float:
    """Largest error of ``name`` after ``ends``, numbers of steps; multipliers are those between two stages."""
    return float(errors(case, solution, "lam_between" if name == "lam" else name, ends).max())


def orders(case: Case, method: str, names: Names = QUANTITIES, *, alternating: bool = False) -> dict[str, float]:
    """Of ``names`` at the end of ``case``, by halving the steps; ``alternating``: 1:2, and over the last steps."""
    runs = [integrated(case, method, lengths(case, count, alternating=alternating)) for count in case.counts]
    some = SOME if alternating else 1
    ends = [range(count - some + 1, count + 1) for count in case.counts]
    found = {name: [worst(case, one, name, at) for one, at in zip(runs, ends, strict=True)] for name in names}
    return {name: slope([1.0 / count for count in case.counts], of) for name, of in found.items()}


def constant_steps(case: Case, methods: Names, names: Names = QUANTITIES) -> list[Row]:
    """Orders of ``methods`` with constant steps."""
    found, rows = {method: orders(case, method, names) for method in methods}, []
    for name in names:
        of = {method: at[name] for method, at in found.items()}
        slow = {method: of.pop(method) for method in FIRST_ORDER.get(case.name, ())}
        claim = f"{case}, constant steps: order of {name} at t = {case.t_end:g}"
        rows.append(order_row(f"order/{case}/{name}", claim, of, 2.0, MARGIN))
        if slow:
            one = f"{claim}; its equations are of order one there"
            rows.append(order_row(f"order/{case}/{name}", one, slow, 1.0, MARGIN))
    return rows


def drift(case: Case) -> list[Row]:
    """Both constraint levels with constant steps: held to roundoff, or left to the method's order."""
    steps = [lengths(case, count) for count in case.counts]
    found = {m: [scaled_drift(case.problem, integrated(case, m, each)) for each in steps] for m in ALL}
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
        runs = [integrated(case, method, lengths(case, count)[: SOME + 1]) for count in case.counts]
        largest = [worst(case, solution, "lam", range(1, SOME + 1)) for solution in runs]
        of[method] = slope([1.0 / count for count in case.counts], largest)
        sizes.append(f"{method} {largest[-1]:.1e}")
    claim, id = f"{case} from t = {case.t_start:g}: worst error of lam in the first {SOME} steps", f"first/{case}"
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
    first, second = (integrated(case, method, steps) for method in ("undamped hht", "rattle"))
    most = max(float(np.abs(first.q - second.q).max()), float(np.abs(first.v - second.v).max()))
    claim = f"{case}: q, v of RATTLE less those of HHT with alpha = 0, b = 0"
    return below_row("rattle/constant force", claim, most, ROUNDOFF)


def leapfrog() -> Row:
    """Period errors where the force depends on the position: those of the leapfrog and of the trapezoidal rule."""
    scene, x = make_scene("oscillator"), 0.1
    of_rattle = swing_of(spectrum(measured_matrix(scene, {}, x, kind=RattleIntegrator)), x).elongation
    of_hht = swing_of(spectrum(measured_matrix(scene, {"alpha": 0.0}, x)), x).elongation
    found = [elongation / x**2 * 24 for elongation in (of_rattle, of_hht)]
    claim = f"oscillator, w h = {x:g}: too long a period by, over (w h)^2/24: RATTLE, HHT with alpha = 0"
    passed = abs(found[0] + 1.0) < LEADING and abs(found[1] / 2.0 - 1.0) < LEADING
    return judged_row("rattle/oscillator", claim, f"{found[0]:.4f}, {found[1]:.4f}", f"-1, 2 +- {LEADING:.0%}", passed)


def vibrations(rho: float, form: str) -> list[Row]:
    """The spectral radius of generalised-alpha on the oscillator, against the closed form and its limit rho_inf."""
    scene, options = make_scene("oscillator"), {"rho_inf": rho, "form": form}
    *found, last = (
        radius(spectrum(measured_matrix(scene, options, x, kind=GeneralisedAlphaIntegrator))) for x in (*FREQUENCIES, 1e8)
    )
    wanted = [radius(spectrum(closed_form(rho, x))) for x in FREQUENCIES]
    most = float(np.abs(np.subtract(found, wanted)).max())
    claim = f"generalised-alpha, {form}, rho_inf = {rho:g}, oscillator: spectral radius"
    return [
        below_row("radius", f"{claim} up to w h = {FREQUENCIES[-1]:g} less that of the closed form", most, SIMPLE),
        below_row("radius", f"{claim} at w h = 1e8 less rho_inf", abs(last - rho), LIMIT),
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
