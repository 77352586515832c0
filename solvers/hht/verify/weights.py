"""``hhtbench verify b``: closed forms, stability, energy, and steps at equal error over b, alpha and the reaction."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hhtbench import list_problems
from hhtbench.evidence import Curve, Evidence, Plot, Row
from hhtbench.request import Request
from solvers.hht.equations.coefficients import ALPHA
from solvers.hht.solver import HHT
from solvers.hht.verify.control import quartiles
from solvers.hht.verify.reaction_weight import best, bounds, listed, local_errors, period_plot, periods, symmetry, turning
from solvers.hht.verify.study import Method, Progress, Study, below_row, collected, run_all, shown_row
from solvers.hht.verify.work import CONSTANT, CONTROLLED, KINDS, Scene, load, refined, run, steps_at

CHOSEN = 0.2  # between the swings of (H32) and what turns
DRAWN: tuple[Scene, ...] = (  # seed, masses, dimensions, spin
    (1, 1, 2, 0.0),
    (2, 1, 3, 3.0),
    (3, 2, 2, 0.0),
    (4, 2, 2, 4.0),
    (5, 2, 3, 2.0),
    (6, 3, 2, 0.0),
    (7, 3, 3, 2.0),
)
MAPPED = (0.0, 0.1, 1.0 / 6.0, 0.2, 0.25, 0.3)
COARSE, FINE = 1e-3, 1e-4  # achieved errors
FACTOR = 1.3  # in steps: what counts as worse than b = 0
SAME = 1e-3  # relative: errors in which b has no part
LONG, LONGER = 100_000, 1_000_000  # steps of the runs whose energy is watched
ROWS, WINDOW = 2001, 200  # rows of those runs; how many at either end have their means compared
KEPT = 1e-3  # of the energy of motion: what its mean may change by
SPARED = 5e-4  # the same at b = 0 after LONGER steps of a chaotic motion
WATCHED: tuple[tuple[Scene, float], ...] = (((1, 1, 2, 0.0), 0.01), ((2, 1, 3, 3.0), 0.01), ((6, 4, 2, 0.0), 0.0025))
CHAOTIC: tuple[Scene, float] = ((3, 2, 2, 0.0), 0.01)
BLIND = ("arevalo_circle", "sundials_slider_crank")  # they gain nothing: is the estimate blind there?
REACTIONS = ("predictor", "midpoint", "midpoint_predictor")


@dataclass(frozen=True)
class Saved:
    """Of one scene and one kind of steps: steps over those with b = 0 at the same error."""

    over_b: Mapping[float, float]  #: at COARSE, for each b; infinite where only b = 0 reaches it, NaN where that does not
    fine: float  #: at FINE, with CHOSEN
    over_alpha: Mapping[float, float]  #: at COARSE, with CHOSEN, for other alphas; constant steps only
    needed: float  #: steps at COARSE with b = 0
    asked: str  #: errors over tolerances with b = 0 and with CHOSEN

    def __str__(self) -> str:
        listed = ", ".join(f"{x:.2f}" for x in self.over_b.values())
        alphas = "".join(f"; alpha {alpha:g}: {x:.2f}" for alpha, x in self.over_alpha.items())
        return f"{listed}; at {FINE:g} {self.fine:.2f}{alphas}{self.asked}"


def verify_b(progress: Progress | None = None, jobs: int = 1) -> Evidence:
    """What the weight b of the end reaction does; some minutes on two cores."""
    began = time.perf_counter()
    cells = [(scene, kind) for scene in (*DRAWN, *constrained()) for kind in KINDS]
    items = run_all(STUDIES, progress, jobs)
    found = run_all([(saved, *cell) for cell in cells], progress, jobs)
    for kind in KINDS:
        own = {scene: at for (scene, of), at in zip(cells, found, strict=True) if of == kind}
        items += [*(_row(kind, scene, at) for scene, at in own.items()), *judged(kind, own), drawn_map(kind, own)]
    return collected("The weight b of the end reaction", items, began)


def constrained() -> list[str]:
    """The problems of the library with position constraints and a known motion, as they are by default."""
    problems = {name: load(name) for name in list_problems()}
    return [
        name
        for name, p in problems.items()
        if hasattr(p.system, "constraint") and (p.exact is not None or p.reference is not None)
    ]


def saved(scene: Scene, kind: str) -> Saved:
    """With constant steps the errors at equal steps, over b and alpha, count by order two; at CHOSEN both are refined."""
    ends = {b: refined(scene, kind, {"b": b}, FINE) for b in (0.0, CHOSEN)}
    needed, fine = (steps_at(ends[0.0], error) for error in (COARSE, FINE))
    over_b = {b: _over(steps_at(runs, COARSE), needed) for b, runs in ends.items()}
    over_alpha: dict[float, float] = {}
    if kind == CONTROLLED:
        others = {b: refined(scene, kind, {"b": b}, COARSE) for b in MAPPED if b not in ends}
        over_b |= {b: _over(steps_at(runs, COARSE), needed) for b, runs in others.items()}
    elif math.isfinite(needed):
        steps = math.ceil(needed)
        over_b |= {b: _equal_steps(scene, steps, {"b": b}, {"b": 0.0}) for b in MAPPED if b not in ends}
        over_alpha = {a: _equal_steps(scene, steps, {"alpha": a, "b": CHOSEN}, {"alpha": a, "b": 0.0}) for a in (0.0, -0.3)}
    asked = [
        f"{min(r.over for r in runs):.2g} to {max(r.over for r in runs):.2g}" if runs else "-" for runs in ends.values()
    ]
    return Saved(
        over_b={b: over_b.get(b, math.nan) for b in MAPPED},
        fine=_over(steps_at(ends[CHOSEN], FINE), fine),
        over_alpha=over_alpha,
        needed=needed,
        asked=f"; error/tolerance {asked[0]}, then {asked[1]}" if kind == CONTROLLED else "",
    )


def _over(steps: float, needed: float) -> float:
    """``steps`` over those ``needed`` with b = 0; infinite where the error is reached with b = 0 only."""
    return math.inf if math.isnan(steps) and not math.isnan(needed) else steps / needed


def _equal_steps(scene: Scene, steps: int, method: Method, other: Method) -> float:
    """Steps of ``method`` over those of ``other`` at equal errors, by order two from their errors at equal steps."""
    found, wanted = run(scene, method, Request(steps=steps)), run(scene, other, Request(steps=steps))
    return math.sqrt(found.error / wanted.error) if found and wanted else _over(math.nan, 1.0 if wanted else math.nan)


def _row(kind: str, scene: Scene, at: Saved) -> Row:
    name = load(scene).name
    claim = f"{name}, {kind}: steps at error {COARSE:g} over those with b = 0 ({at.needed:.0f}), b = {listed(MAPPED)}"
    return shown_row(f"{kind}/{name}", claim, str(at))


def judged(kind: str, own: Mapping[Scene, Saved]) -> list[Row]:
    """The medians over the library, and the problems that take more steps than with b = 0."""
    rows, library = [], {scene: at for scene, at in own.items() if isinstance(scene, str)}
    for error, ratios in (
        (COARSE, {scene: at.over_b[CHOSEN] for scene, at in library.items()}),
        (FINE, {scene: at.fine for scene, at in library.items()}),
    ):
        reached = {scene: ratio for scene, ratio in ratios.items() if not math.isnan(ratio)}
        worse = {scene: ratio for scene, ratio in reached.items() if ratio > FACTOR}
        turned = [ratio for ratio in reached.values() if abs(ratio - 1) > SAME]
        seen = f"{kind}, error {error:g}, b = {CHOSEN:g}, {len(reached)} problems with position constraints"
        shown = ", ".join(f"{scene} {ratio:.2f}" for scene, ratio in worse.items()) or "none"
        rows += [
            shown_row(
                f"{kind}/median", f"{seen}: median of steps over those with b = 0", f"{_median(reached.values()):.2f}"
            ),
            shown_row(
                f"{kind}/moved", f"{seen}: median of the {len(turned)} where b changes anything", f"{_median(turned):.2f}"
            ),
            shown_row(f"{kind}/worse", f"{seen}: more than {FACTOR:g} times the steps", shown),
        ]
    others = ", ".join(f"{b:.3g}: {_median(at.over_b[b] for at in library.values()):.2f}" for b in MAPPED)
    rows.append(shown_row(f"{kind}/medians", f"{kind}, error {COARSE:g}, library: the median for each b", others))
    others = ", ".join(
        f"{b:.3g}: {_median(at.over_b[b] for scene, at in own.items() if not isinstance(scene, str)):.2f}" for b in MAPPED
    )
    return [*rows, shown_row(f"{kind}/drawn", f"{kind}, error {COARSE:g}, drawn scenes: the median for each b", others)]


def _median(ratios: Iterable[float]) -> float:
    return float(np.nanmedian(list(ratios)))


def drawn_map(kind: str, own: Mapping[Scene, Saved]) -> Plot:
    """Median, quartiles and extremes over b."""
    table = np.array([[at.over_b[b] for b in MAPPED] for at in own.values()])
    levels = {"least": 0.0, "lower quartile": 0.25, "median": 0.5, "upper quartile": 0.75, "most": 1.0}
    return Plot(
        id=f"{kind}/map",
        title=f"Steps at equal error over the weight b: {kind}",
        caption=f"Over those with b = 0, at error {COARSE:g}, of all constrained problems of the library and drawn scenes.",
        x_label="b",
        y_label="steps over those with b = 0",
        curves=tuple(
            Curve(label=label, x=MAPPED, y=tuple(np.nanquantile(table, level, axis=0).tolist()))
            for label, level in levels.items()
        ),
        logarithmic=False,
    )


def reactions(scene: Scene) -> Row:
    """Errors at equal steps with the other reactions, as steps at equal errors."""
    steps = math.ceil(steps_at(refined(scene, CONSTANT, {"b": 0.0}, COARSE), COARSE))
    methods = {f"predictor, b = {b:g}": {"reaction": "predictor", "b": b} for b in (0.0, CHOSEN, 0.3)}
    methods |= {name: {"reaction": name, "b": 0.0} for name in REACTIONS[1:]}
    found = {name: _equal_steps(scene, steps, method, {"b": 0.0}) for name, method in methods.items()}
    claim = f"{load(scene).name}, {steps} constant steps: steps at equal error over those of implicit, b = 0"
    return shown_row("reactions", claim, ", ".join(f"{name} {x:.2f}" for name, x in found.items()))


def energy(scene: Scene, h: float, steps: int, alphas: Sequence[float]) -> list[Row]:
    """The change of energy's mean from the first to the last tenth of a long run, over the largest kinetic energy."""
    rows = []
    for alpha in alphas:
        found = {b: energy_change(scene, {"alpha": alpha, "b": b}, h, steps) for b in MAPPED}
        claim = f"{load(scene).name}, alpha = {alpha:g}, implicit, {steps:,} steps of {h:g} s: change of the mean energy"
        text = ", ".join(f"b = {b:.3g}: {x:.0e}" for b, x in found.items())
        worst = float(np.max(np.abs(list(found.values()))))  # NaN where one cannot be followed: no pass
        rows.append(Row(id="energy", claim=f"{claim} ({text})", measured=worst, bound=f"< {KEPT:g}", passed=worst < KEPT))
    others = [{"reaction": r, "b": b, "alpha": 0.0} for r, b in (("predictor", 0.0), ("predictor", CHOSEN))]
    others += [{"reaction": r, "b": 0.0, "alpha": 0.0} for r in REACTIONS[1:]]
    text = ", ".join(f"{m['reaction']}, b = {m['b']:g}: {energy_change(scene, m, h, steps):.0e}" for m in others)
    return [
        *rows,
        shown_row("energy/reactions", f"{load(scene).name}, alpha = 0, {steps:,} steps of {h:g} s: the same", text),
    ]


def chaotic(scene: Scene, h: float, steps: int) -> Row:
    """The same of a chaotic motion: symmetric is not symplectic, and energy wanders unless b = 0."""
    found = {b: energy_change(scene, {"alpha": 0.0, "b": b}, h, steps) for b in (0.0, CHOSEN, 0.3)}
    text = ", ".join(f"b = {b:.3g}: {x:.0e}" for b, x in found.items())
    claim = f"{load(scene).name}, alpha = 0, implicit, {steps:,} steps of {h:g} s: change of the mean energy ({text}), b = 0"
    return below_row("energy/chaotic", claim, abs(found[0.0]), SPARED)


def energy_change(scene: Scene, method: Method, h: float, steps: int) -> float:
    """NaN where the motion cannot be followed."""
    p = load(scene)
    rows = np.linspace(0.0, steps * h, ROWS)
    solution = HHT(p.system, **method).solve((0.0, steps * h), p.q0, p.v0, steps=steps, t_eval=rows)
    if not solution.success:
        return math.nan
    energies = p.system.energies(solution.q, solution.v)  # type: ignore[union-attr]
    motion = p.system.energies(solution.q, solution.v) - p.system.energies(solution.q, 0 * solution.v)  # type: ignore[union-attr]
    return float((energies[-WINDOW:].mean() - energies[:WINDOW].mean()) / motion.max())


STUDIES: tuple[Study, ...] = (
    (local_errors, 0.7, 2.0, 5e-4),
    *((periods, amplitude, 1000) for amplitude in (0.1, math.pi / 2, 2.4)),
    (best, 1000),
    (turning, 4000),
    (symmetry, 3, 200, 0.005),
    *((bounds, seed, count) for seed, count in ((1, 1), (2, 3), (3, 6))),
    *((reactions, scene) for scene in DRAWN),
    *((energy, scene, h, LONG, (0.0, ALPHA)) for scene, h in WATCHED),
    (chaotic, *CHAOTIC, LONGER),
    *((quartiles, spec, {"b": b}) for spec in BLIND for b in (0.0, CHOSEN)),
    (period_plot, (0.1, math.pi / 4, math.pi / 2, 2.4)),
)
