"""``hhtbench verify control``: achieved over requested error for all problems and tolerances."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence

import numpy as np

from hhtbench import list_problems
from hhtbench.campaign.reference.plan import registered_plans, validated_spec
from hhtbench.protocol.evidence import Curve, Evidence, Plot, Row
from hhtbench.solution.request import Request
from solvers.hht.verify.measure import Run, run
from solvers.hht.verify.study import Progress, collected, judged_row, order_row, run_all, shown_row, slope

TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
NEAR = 10.0  # factor around the calibrated error within which an error counts as requested
SHARE = 0.9  # share of runs that must be so near
SLOPE = 0.2  # largest deviation of the slope of error over tolerance from 1
REJECTED = 0.15  # largest share of rejected steps
MAX_SECONDS = 60.0  # of one solve [s]
Runs = list[Run]  # runs on one problem, one for each tolerance


def verify_control(progress: Progress | None = None, jobs: int = 1) -> Evidence:
    """Evidence on error control: achieved over requested error, slopes and rejections."""
    began, plan = time.perf_counter(), registered_plans()
    specs = [validated_spec(name, plan) for name in list_problems()]
    requests = [Request(rtol=x, max_seconds=MAX_SECONDS) for x in TOLERANCES]
    runs = run_all([(run, spec, request) for spec in specs for request in requests], progress, jobs)
    library = [runs[k : k + len(TOLERANCES)] for k in range(0, len(runs), len(TOLERANCES))]
    items = [*problem_rows(library), *overall_rows(library), drawn(library)]
    return collected("Error control: requested and achieved error", items, began)


def problem_rows(library: Iterable[Runs]) -> list[Row]:
    """Per problem a row with ratios of achieved to requested error (shown) and one with the slope (judged)."""
    rows = []
    for own in library:
        spec, curve = own[0].spec, _curve(own)
        claim = f"{spec}: achieved/requested at 1e-2 .. 1e-6; constant {_constant(own):.2g}"
        rows.append(shown_row(f"ratio/{spec}", claim, ", ".join(map(str, own))))
        id, claim = f"slope/{spec}", f"{spec}: slope of error over tolerance, both logarithmic"
        if len(curve.x) < 3:
            rows.append(shown_row(id, claim, "fewer than three errors above roundoff"))
        else:
            rows.append(order_row(id, claim, {"slope": slope(curve.x, curve.y)}, 1.0, SLOPE))
    return rows


def overall_rows(library: Sequence[Runs]) -> list[Row]:
    """Rows for the share of runs whose error is near the requested one, and for the share of rejected steps."""
    runs = [run for own in library for run in own]
    near = 0
    for own in library:
        near += sum(run.error is not None and run.ratio is None for run in own)  # roundoff is as good as it gets
        near += sum(1 / NEAR <= run.ratio / _constant(own) <= NEAR for run in own if run.ratio is not None)
    share, part = near / len(runs), sum(run.rejected for run in runs) / max(1, sum(run.steps for run in runs))
    worst = max(runs, key=lambda run: run.rejected / max(1, run.steps))
    claim = f"runs whose achieved/requested error lies within a factor of {NEAR:g} of its problem's constant"
    text = f"{near} of {len(runs)}: {share:.0%}"
    most = f"{part:.1%}; most in {worst.spec} at {worst.tolerance:g}: {worst.rejected} of {worst.steps}"
    return [
        judged_row("ratio/all", claim, text, f">= {SHARE:.0%}", share >= SHARE),
        judged_row("rejected/all", "rejected steps, of all runs together", most, f"< {REJECTED:.0%}", part < REJECTED),
    ]


def _constant(own: Runs) -> float:
    """Geometric mean of the error ratios of one problem."""
    ratios = [run.ratio for run in own if run.ratio is not None]
    return float(np.exp(np.mean(np.log(ratios)))) if ratios else 1.0


def _curve(runs: Runs) -> Curve:
    """Errors above roundoff over the tolerance."""
    points = [(run.tolerance, run.error) for run in runs if run.error is not None and run.ratio is not None]
    return Curve(label=runs[0].spec, x=tuple(x for x, _ in points), y=tuple(y for _, y in points))


def drawn(library: Iterable[Runs]) -> Plot:
    """Plot of error over tolerance, a curve for every problem that has errors above roundoff."""
    return Plot(
        id="control",
        title="Achieved over requested error",
        caption="Largest weighted error of q and v over time against the tolerance; the guide line has slope one.",
        x_label="tolerance",
        y_label="error",
        curves=tuple(curve for curve in map(_curve, library) if curve.x),
        slope=1.0,
    )
