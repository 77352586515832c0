"""``hhtbench verify reactions``: errors of multipliers beside those of v, and the noise of the ways to read them.

The first rows compare, for every problem with multipliers, their relative error at rows with that of v.  The others
compare multipliers of rows, which follow from the state there, (H16), with the two that every step has of its own: their
mean belongs to the middle of the step and is of order two (THEORY.md, section 6).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hhtbench import list_problems, load_problem, solve
from hhtbench.advice.features import probe
from hhtbench.campaign.reference.plan import registered_plans, validated_spec
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.evidence import Evidence, Row
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import declared
from hhtbench.solution.result import Solution
from solvers.hht.verify.measure import Case, known_motion
from solvers.hht.verify.study import ALPHAS, NAMES, Method, Progress, Study, below_row, judged_row, shown_row, verify

TOLERANCES = (1e-3, 1e-4, 1e-5)
MAX_RATIO = 10.0  # of the relative error of multipliers to that of v
FAST = 100.0  # rate of the fastest mode over that of the motion from which vibrations too small to see carry forces
ROUNDOFF = 1e-12  # relative error of v below which there is nothing to compare
MAX_SECONDS = 240.0  # of one solve [s], which takes some on an idle core
RIVALS = ("ida", "scipy(method=Radau)", "generalised_alpha")
RIVAL_RTOL, RIVAL_ROWS = 1e-4, 401
NOISY_TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
EXTRAPOLATED = "extrapolate_reaction"
METHODS: dict[str, Method] = {NAMES[x]: {"alpha": x} for x in ALPHAS[:4]} | {EXTRAPOLATED: {EXTRAPOLATED: True}}
DEFAULT = NAMES[-0.05]
GAIN = 2.0  # least factor that means gain where a vibration is not resolved
UNRESOLVED = "stiff_spring_pendulum(stiffness=1e8, t_end=0.3)"  # 1e4 rad/s
SCENES: dict[str, tuple[int, int]] = {  # with two numbers of constant steps
    "bead_chain": (100, 400),
    "andrews": (200, 800),
    "right_angle_cantilever": (80, 320),
    "flexible_crank(t_end=0.01)": (100, 400),
    "spinup_beam(t_end=1.0)": (20, 80),
    UNRESOLVED: (30, 120),
}
SMOOTH = ("bead_chain", "andrews")


def forces_of(rows: Any) -> Matrix:
    """lam and mu of ``rows`` side by side, (k, m + p)."""
    return np.hstack([rows.lam, rows.mu])


def relative(found: Matrix, right: Matrix) -> float:
    """Largest error over the rows relative to the largest value, both as 2-norms of a row; 0 where there is neither."""
    size = np.linalg.norm(right, axis=1).max()
    return float(np.linalg.norm(found - right, axis=1).max() / size) if size else 0.0


class AtRows(NamedTuple):
    """Relative errors at the rows at which the motion is known."""

    v: float
    forces: float  #: of lam and mu

    @property
    def ratio(self) -> float:
        """Error of the multipliers over that of v; 0 where that of v is roundoff."""
        return self.forces / self.v if self.v > ROUNDOFF else 0.0

    def __str__(self) -> str:
        return f"{self.ratio:.2g} ({self.forces:.1e} over {self.v:.1e})"


def errors_at_rows(spec: str, solver: str, rtol: float) -> AtRows | None:
    """Errors of ``solver`` at the rows of the closed solution or the reference; None where the run fails."""
    problem = load_problem(spec)
    times, _ = known_motion(problem)
    case = Case(spec, float(problem.t_span[1]))
    known = [case.known(float(t)) for t in times]
    found = solve(problem, solver, rtol=rtol, t_eval=times, max_seconds=MAX_SECONDS)
    if not found.success:
        return None
    right = np.array([np.concatenate([at.lam, at.mu]) for at in known])
    return AtRows(relative(found.v, np.array([at.v for at in known])), relative(forces_of(found), right))


def ratios(spec: str) -> list[Row]:
    """Rows for one problem: its ratios, judged where it has no fast vibrations, and Radau's where ours are too large."""
    problem = load_problem(spec)
    found = [errors_at_rows(spec, "hht", rtol) for rtol in TOLERANCES]
    stiffness = probe(problem).features.stiffness
    smooth = "stiff" not in problem.tags and stiffness < FAST
    fast = f"fastest mode {stiffness:.0f} times the pace of the motion"
    kind = "smooth" if smooth else fast if stiffness >= FAST else "stiff"
    claim = f"{spec} ({kind}): relative error of multipliers over that of v at 1e-3, 1e-4, 1e-5"
    text, largest = ", ".join(map(str, found)), max((at.ratio for at in found if at), default=np.inf)
    if smooth:
        held = None not in found and largest <= MAX_RATIO
        return [judged_row(f"rows/{spec}", claim, text, f"<= {MAX_RATIO:g}", held)]
    rows = [shown_row(f"rows/{spec}", claim, text)]
    if largest > MAX_RATIO:
        radau = errors_at_rows(spec, RIVALS[1], RIVAL_RTOL)
        rows.append(shown_row(f"radau/{spec}", f"{spec}: the same of Radau at {RIVAL_RTOL:g}", str(radau)))
    return rows


class Reading(NamedTuple):
    """Multipliers of one run, read in one way."""

    t: Vector  #: (k,) [s]
    values: Matrix  #: (k, m)


def readings(solution: Solution) -> dict[str, Reading]:
    """Multipliers of the rows at the ends of steps, of either end of each step, and their means in the middle of it."""
    data: Any = solution.steps_data
    return {
        "rows": Reading(solution.t, solution.lam),
        "means": Reading(data.t - data.h / 2, (data.lam_start + data.lam_end) / 2),
        "starts": Reading(data.t - data.h, data.lam_start),
        "ends": Reading(data.t, data.lam_end),
    }


class Noise(NamedTuple):
    """Root mean squares of an error relative to the largest value, and of its part that alternates between neighbours."""

    error: float
    noise: float

    def __str__(self) -> str:
        return f"{self.error:.1e} ({self.noise:.1e})"


def noise_of(error: Matrix, size: float) -> Noise:
    """Measures of ``error`` (k, m); second differences over the root of 6 keep the variance of independent noise.

    The noise of fewer than three rows is NaN.
    """
    bends = np.diff(error, 2, axis=0) / np.sqrt(6.0)
    return Noise(*(float(np.sqrt(np.sum(x**2) / (len(x) or np.nan))) / size for x in (error, bends)))


def solved_by(problem: Problem, solver: str, **how: Any) -> Solution:
    """Solve ``problem``; raises ``RuntimeError`` if the run fails, since there is nothing to measure then."""
    found = solve(problem, solver, max_seconds=MAX_SECONDS, **how)
    if not found.success:
        raise RuntimeError(f"{problem.name} by {solver}: {found.status.label}: {found.message}")
    return found


def measured(spec: str, requests: dict[str, dict[str, Any]]) -> dict[tuple[str, str], dict[str, Noise]]:
    """Noise of every reading by request and method, and of the rivals' rows, against a tight explicit run."""
    problem, runs = load_problem(spec), dict[tuple[str, str], dict[str, Reading]]()
    for name, request in requests.items():
        for label, method in METHODS.items():
            options = ", ".join(f"{key}={value}" for key, value in method.items())
            runs[name, label] = readings(solved_by(problem, f"hht({options})", **request))
    even = np.linspace(*problem.t_span, RIVAL_ROWS)
    for rival in RIVALS:
        how: dict[str, Any] = {"steps": SCENES[spec][1]} if rival == RIVALS[2] else {"rtol": RIVAL_RTOL}
        found = solve(problem, rival, t_eval=even, max_seconds=MAX_SECONDS, **how)
        if found.success:
            runs["rivals", rival] = {"rows": Reading(even, found.lam)}
    times = np.unique(np.concatenate([at.t for run in runs.values() for at in run.values()]).clip(*problem.t_span))
    right = solved_by(problem, "projected(method=DOP853)", rtol=1e-11, t_eval=times).lam
    size = float(np.linalg.norm(right, axis=1).max())
    at_times = lambda t: right[np.searchsorted(times, t.clip(*problem.t_span))]  # noqa: E731
    return {key: {way: noise_of(x.values - at_times(x.t), size) for way, x in run.items()} for key, run in runs.items()}


def noise(spec: str) -> list[Row]:
    """Rows for one scene: errors and noise of rows and of means by alpha, those of single stages, and the rivals'."""
    requests: dict[str, dict[str, Any]] = {f"rtol {rtol:g}": {"rtol": rtol} for rtol in NOISY_TOLERANCES}
    requests |= {f"{steps} steps": {"steps": steps} for steps in SCENES[spec]}
    found = measured(spec, requests)
    rows = []
    for name in requests:
        of = {method: at for (request, method), at in found.items() if request == name}
        text = "; ".join(f"{method}: {at['rows']} -> {at['means']}" for method, at in of.items())
        claim = f"{spec}, {name}: rms error (noise) of multipliers by alpha, rows -> means over steps"
        rows.append(shown_row(f"noise/{spec}/{name}", claim, text))
    single = "; ".join(f"{name}: {at['starts']}, {at['ends']}" for name in requests for at in [found[name, DEFAULT]])
    rows.append(shown_row(f"stages/{spec}", f"{spec}: the same of the stages at the start and the end of steps", single))
    others = "; ".join(f"{rival} {at['rows']}" for (name, rival), at in found.items() if name == "rivals")
    rows.append(
        shown_row(f"rivals/{spec}", f"{spec}: the same of rows of others, rtol {RIVAL_RTOL:g} or as many steps", others)
    )
    return rows + _judged(spec, [found[name, DEFAULT] for name in requests if "rtol" in name])


def _judged(spec: str, found: list[dict[str, Noise]]) -> list[Row]:
    """Rows for what the page on joint forces says of smooth scenes and of vibrations that steps do not resolve."""
    gains = [at["rows"].error / at["means"].error for at in found]
    if spec in SMOOTH:
        claim = f"{spec}, smooth: error of rows over that of means over steps, largest of all tolerances"
        return [below_row(f"default/{spec}", claim, max(gains), GAIN)]
    if spec != UNRESOLVED:
        return []
    claim = f"{spec}: error of rows over that of means over steps, least of all tolerances"
    return [judged_row(f"gain/{spec}", claim, min(gains), f"> {GAIN:g}", min(gains) > GAIN)]


def with_multipliers() -> list[str]:
    """Specs of the library's problems that have multipliers and a known motion."""
    plan, names = registered_plans(), list_problems()
    problems = {validated_spec(name, plan): load_problem(name) for name in names}
    declares = {
        spec: any(declared(p.system, x) is not None for x in ("constraint", "velocity_constraint"))
        for spec, p in problems.items()
    }
    known = {spec: p.exact is not None or p.reference is not None for spec, p in problems.items()}
    return [spec for spec in problems if declares[spec] and known[spec]]


def verify_reactions(progress: Progress | None = None, jobs: int = 1) -> Evidence:
    """Evidence on multipliers at rows and on the noise of their readings; a few minutes."""
    studies: list[Study] = [*((ratios, spec) for spec in with_multipliers()), *((noise, spec) for spec in SCENES)]
    return verify("Multipliers: errors at rows, noise, and means over steps", studies, progress, jobs)
