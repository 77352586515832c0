"""``hhtbench verify rivals``: observed orders of other alpha methods against the published ones, beside the extended HHT."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.evidence import Evidence, Row
from hhtbench.solution.result import Solution
from solvers.hht.rivals import GeneralisedAlphaIntegrator, HHTI3Integrator, RattleIntegrator
from solvers.hht.solver import HHT
from solvers.hht.verify.measure import Case, errors, integrate, scaled_drift
from solvers.hht.verify.measure import alternating as pairs
from solvers.hht.verify.study import Method, Progress, Study, below_row, order_row, shown_row, slope, verify

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
MARGIN = 0.1  # tolerated deviation of observed orders
ROUNDOFF = 1e-12  # scaled violation of a level that a method satisfies
SOME = 5  # first or last steps of which the largest error counts, as errors of multipliers may alternate

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
    """Evidence on orders, drift, first steps and changing steps of generalised-alpha, HHT-I3 and RATTLE; about a minute."""
    return verify("The field's own methods beside the extended HHT", STUDIES, progress, jobs)


def integrated(case: Case, method: str, steps: Vector) -> Solution:
    """Solve ``case`` from its start with ``steps`` (k,) [s] by the named method."""
    kind, options = METHODS[method]
    return integrate(case, steps, kind, **options)


def lengths(case: Case, count: int, *, alternating: bool = False) -> Vector:
    """Step lengths: ``count`` to the end of ``case``, equal or alternating 1:2, and one beyond."""
    steps = pairs(case, count // 2) if alternating else np.full(count, (case.t_end - case.t_start) / count)
    return np.append(steps, steps[0])


def worst(case: Case, solution: Solution, name: str, ends: Iterable[int]) -> float:
    """Largest error of ``name`` after ``ends``, counted in steps; multipliers are interpolated between two stages."""
    return float(errors(case, solution, "lam_between" if name == "lam" else name, ends).max())


def orders(case: Case, method: str, names: Names = QUANTITIES, *, alternating: bool = False) -> dict[str, float]:
    """Observed orders of ``names`` at the end of ``case``; ``alternating``: steps 1:2, largest error of the last steps."""
    runs = [integrated(case, method, lengths(case, count, alternating=alternating)) for count in case.counts]
    some = SOME if alternating else 1
    ends = [range(count - some + 1, count + 1) for count in case.counts]
    found = {name: [worst(case, one, name, at) for one, at in zip(runs, ends, strict=True)] for name in names}
    return {name: slope([1.0 / count for count in case.counts], of) for name, of in found.items()}


def order_rows(id: str, claim: str, found: dict[str, float], wanted: dict[str, float]) -> list[Row]:
    """Rows of the orders ``found`` by method: one per order ``wanted``, and one not judged for methods without."""
    rows = []
    for order in (2.0, 1.0, None):
        of = {method: at for method, at in found.items() if wanted.get(method) == order}
        if of:
            rows.append(shown_row(id, claim, of) if order is None else order_row(id, claim, of, order, MARGIN))
    return rows


def constant_steps(case: Case, methods: Names, names: Names = QUANTITIES) -> list[Row]:
    """Rows: orders of ``methods`` with constant steps."""
    found, rows = {method: orders(case, method, names) for method in methods}, list[Row]()
    wanted = dict.fromkeys(methods, 2.0) | dict.fromkeys(FIRST_ORDER.get(case.name, ()), 1.0)
    for name in names:
        claim = f"{case}, constant steps: order of {name} at t = {case.t_end:g}"
        rows += order_rows(f"order/{case}/{name}", claim, {method: at[name] for method, at in found.items()}, wanted)
    return rows


def changing_steps(case: Case) -> list[Row]:
    """Rows: orders with steps 1:2, judged for methods designed for these; index 3 loses that of its multipliers."""
    found = {m: orders(case, m, alternating=True) for m in (*ALL, "ggl not rescaled", "index3 not rescaled")}
    wanted, rows = dict.fromkeys(BOTH_LEVELS, 2.0), list[Row]()
    for name in QUANTITIES:
        of = {method: at[name] for method, at in found.items()}
        rows += order_rows(f"changing/{case}/{name}", f"{case}, steps 1:2: order of {name}", of, wanted)
    return rows


def drift(case: Case) -> list[Row]:
    """Rows: violation of both levels with constant steps, either roundoff or of the method's order."""
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
    """Rows: order of the largest multiplier error in the first steps, by kind of start."""
    of, sizes = dict[str, float](), list[str]()
    for method in (*BEGIN_WELL, *BEGIN_BADLY):
        runs = [integrated(case, method, lengths(case, count)[: SOME + 1]) for count in case.counts]
        largest = [worst(case, solution, "lam", range(1, SOME + 1)) for solution in runs]
        of[method] = slope([1.0 / count for count in case.counts], largest)
        sizes.append(f"{method} {largest[-1]:.1e}")
    claim, id = f"{case} from t = {case.t_start:g}: worst error of lam in the first {SOME} steps", f"first/{case}"
    wanted = dict.fromkeys(BEGIN_WELL, 2.0) | dict.fromkeys(BEGIN_BADLY, 1.0)
    sizes_row = shown_row(id, f"{claim}, {case.counts[-1]} steps a span", ", ".join(sizes))
    return [*order_rows(id, f"{claim}, its order", of, wanted), sizes_row]


STUDIES: tuple[Study, ...] = (
    *((constant_steps, case, ALL) for case in CASES),
    (constant_steps, KNIFE, ("hht", "extended"), ("q", "v")),
    *((drift, case) for case in CASES),
    (first_steps, SWING),
    (changing_steps, replace(SWING, counts=(800, 1600, 3200))),
)
