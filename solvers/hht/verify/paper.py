"""``hhtbench verify paper``: orders over alpha, b and the reactions, local errors, drift, and the figures."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.evidence import Evidence, Row
from solvers.hht.solver import HHT
from solvers.hht.verify.damping import OSCILLATOR
from solvers.hht.verify.figures import pendulum_figures, test1_figures
from solvers.hht.verify.measure import (
    Case,
    alternating,
    guesses,
    integrate,
    refine,
    scaled_drift,
    step_by_hand,
)
from solvers.hht.verify.study import (
    ALPHAS,
    NAMES,
    Method,
    Progress,
    Study,
    below_row,
    judged_row,
    named,
    order_row,
    slope,
    verify,
)

MARGIN = 0.05  # tolerated deviation of observed orders
STAGE_MARGIN = 0.1  # of the observed order of stage multipliers
LOST = 0.3  # margin within which an observed order counts as one
SEED = 20070101  # of the random step pattern; any other seed gives second order too
PATTERN = 8  # steps in one period of the random pattern
HELD = 1e-12  # scaled violation that counts as roundoff
LOCAL_MARGIN = 0.1  # tolerated deviation of local orders: before roundoff the step cannot be as small as for a global order


def verify_paper(progress: Progress | None = None, jobs: int = 1) -> Evidence:
    """Evidence on every claim of the paper that this implementation makes; a minute on one core."""
    return verify("The paper's claims, reproduced", STUDIES, progress, jobs)


def methods(alpha: float) -> Iterator[Method]:
    """Yield all members of the family with this ``alpha``; each must be of order two."""
    for reaction, b in itertools.product(("implicit", "predictor"), (0.0, 0.3, 1.0)):
        yield {"alpha": alpha, "b": b, "reaction": reaction}
    for reaction in ("midpoint", "midpoint_predictor"):
        yield {"alpha": alpha, "b": 0.0, "reaction": reaction}


def second_order(case: Case, kind: str, keys: str, numbers: Sequence[int], methods: Iterable[Method]) -> list[Row]:
    """Rows: order two of ``keys`` for constraints of a ``kind``, with each of the ``methods``."""
    found = {named(method): refine(case, numbers, **method).orders(keys.split()) for method in methods}
    return [order_row(f"{kind}/{case}", f"{name}: orders (RMS)", orders, 2.0, MARGIN) for name, orders in found.items()]


def random_pattern(case: Case, periods: int) -> Vector:
    """Step lengths: a fixed random pattern with ratios of neighbours in [1/2, 2], repeated ``periods`` times."""
    pattern = np.random.default_rng(SEED).uniform(1.0, 2.0, PATTERN)
    return np.tile(pattern / pattern.sum() * ((case.t_end - case.t_start) / periods), periods)


def variable_steps(case: Case, alpha: float, b: float, periods: Sequence[int], finer: Sequence[int]) -> list[Row]:
    """Rows: order with and without (H11) on alternating steps, and with it on the random pattern.

    Without it one order is lost unless alpha = 0, where a0 is used at its own time; ``finer``: more steps, as the
    first-order part only then dominates.
    """
    pairs, random = [alternating(case, 4 * n) for n in periods], [random_pattern(case, n) for n in periods]
    fine, lost = [alternating(case, n) for n in finer], (2.0, MARGIN) if alpha == 0.0 else (1.0, LOST)
    rows = []
    for steps, rescale_a, text, wanted in (
        (pairs, True, "alternating h/3, 2h/3 with (2.3)", (2.0, MARGIN)),
        (random, True, "random ratios in [1/2, 2] with (2.3)", (2.0, MARGIN)),
        (fine, False, "alternating h/3, 2h/3 without (2.3)", lost),
    ):
        orders = refine(case, steps, alpha=alpha, b=b, reaction="implicit", rescale_a=rescale_a).orders()
        rows.append(order_row(f"steps/{case}", f"b = {b:g}, alpha = {NAMES[alpha]}: {text}", orders, *wanted))
    return rows


def multipliers(case: Case, alpha: float, numbers: Sequence[int]) -> list[Row]:
    """Rows: orders of the stage multipliers, of their mean at the midpoint and of the recovered ones."""
    found, id, name = refine(case, numbers, alpha=alpha, b=0.0), f"multipliers/{case}", f"alpha = {NAMES[alpha]}"
    stages, others = found.orders(("lam_start", "lam_end")), found.orders(("lam_mean", "lam"))
    claim = f"{name}: their mean at the midpoint, and those recovered from the acceleration level"
    return [
        order_row(id, f"{name}: stage multipliers at t0 and t1 (RMS order)", stages, 1.0, STAGE_MARGIN),
        order_row(id, claim, others, 2.0, MARGIN),
    ]


def local_errors(case: Case, alpha: float, longest: float, count: int = 5) -> list[Row]:
    """Rows: orders of the local errors of q and v for each a0 of (H12), from ``count`` halvings of the step [s]."""
    rows, steps, p = [], [longest / 2**k for k in range(count)], case.problem
    for start in ("f0", "shifted", "trapezoidal"):
        errors = []
        for h in steps:
            hht = HHT(p.system, alpha=alpha, start=start)
            hht.init_step(p.t_span[0], p.q0, p.v0, step=h, **guesses(p))
            state, end = step_by_hand(case.name, hht), case.known(p.t_span[0] + h)
            errors.append([np.linalg.norm(state.q - end.q), np.linalg.norm(state.v - end.v)])
        q, v = (slope(steps, column) for column in np.transpose(errors))
        wanted = 3.0 if alpha == 0.0 or start != "f0" else 2.0
        claim = f"alpha = {NAMES[alpha]}, a0 = {start}: order of the local errors (Theorem 4.3)"
        passed = abs(q - 3.0) <= LOCAL_MARGIN and abs(v - wanted) <= LOCAL_MARGIN
        bound = f"q 3, v {wanted:g}, +- {LOCAL_MARGIN}"
        rows.append(judged_row(f"local/{case}", claim, f"q {q:.3f}, v {v:.3f}", bound, passed))
    return rows


def multiplier_guess(case: Case, factors: Sequence[float], h: float) -> Row:
    """Row: largest change of q1, v1 when Newton's iteration starts from other multipliers (Remark 4.2)."""
    ends, rejected, p = [], 0, case.problem
    for factor in factors:
        hht = HHT(p.system, alpha=-0.15, b=0.3)
        hht.init_step(p.t_span[0], p.q0, p.v0, step=h, **guesses(p))
        hht.restart(replace(hht.state, lam=hht.state.lam * factor))
        state = step_by_hand(case.name, hht)
        rejected += hht.counters.steps_rejected_newton or 0
        ends.append(np.concatenate([state.q, state.v]))
    change = float(np.max(np.abs(np.array(ends) - ends[0])))
    shown = ", ".join(f"{factor:g}" for factor in factors)
    claim = f"{case}: change of q1, v1 for starting multipliers times {shown}, no step tried again (Remark 4.2)"
    return below_row("guess", claim, math.inf if rejected else change, 1e-12)


def drift(case: Case, steps: int, methods: Sequence[Method]) -> list[Row]:
    """Rows: largest scaled violation of both levels over all steps."""
    rows = []
    for method in methods:
        held = max(scaled_drift(case.problem, integrate(case, steps, **method)))
        claim = f"{named(method)}: largest scaled residual of both constraint levels over {steps} steps"
        rows.append(below_row(f"drift/{case}", claim, held, HELD))
    return rows


def end_values(case: Case, steps: int) -> list[Row]:
    """Rows: q and v at the end, by the default method, against the reference."""
    solution, known, rows = integrate(case, steps), case.known(case.t_end), []
    for name, found, wanted in (("q", solution.q[-1], known.q), ("v", solution.v[-1], known.v)):
        off = float(np.max(np.abs(found - wanted)) / np.max(np.abs(wanted)))
        claim = f"{name}({case.t_end:g}) with {steps:,} steps: error over max|{name}|"
        rows.append(below_row(f"{case}", claim, off, 1e-6))
    return rows


TEST1 = Case("jay_negrut_test1", 1.0, 20)
PENDULUM = Case("jay_negrut_pendulum", 2.0, 25)
KNIFE = Case("knife_edge", 2.0, 20)
DISK = Case("rolling_disk3d_steady", 2.0, 20)
CHAIN = Case("oscillator_chain", 0.5, 20)
ANDREWS = Case("andrews", 0.03)
ON_TEST1, ON_PENDULUM = (100, 200, 400, 800, 1600), (250, 500, 1000, 2000)  # numbers of constant steps
IMPLICIT = [{"alpha": alpha, "b": 0.0} for alpha in (0.0, -0.05, -0.3)]
WEIGHTED = [{"alpha": -0.15, "b": 0.3, "reaction": reaction} for reaction in ("implicit", "predictor")]
PLAIN = [{"alpha": alpha} for alpha in (0.0, -0.3)]
DAMPINGS = [{"alpha": alpha} for alpha in (0.0, -0.05, -1.0 / 3.0)]
REACTIONS = [*DAMPINGS, *WEIGHTED, {"alpha": -0.15, "reaction": "midpoint"}]
STUDIES: tuple[Study, ...] = (
    (test1_figures, TEST1),
    (pendulum_figures, PENDULUM),
    *((second_order, TEST1, "order", "q v a", ON_TEST1, tuple(methods(alpha))) for alpha in ALPHAS),
    *((variable_steps, TEST1, alpha, 0.3, (20, 40, 80, 160), (320, 640, 1280)) for alpha in ALPHAS),
    *((second_order, PENDULUM, "order", "q v a", ON_PENDULUM, tuple(methods(alpha))) for alpha in ALPHAS),
    *((variable_steps, PENDULUM, alpha, 0.0, (50, 100, 200, 400), (1000, 2000, 4000)) for alpha in ALPHAS),
    *((local_errors, TEST1, alpha, 0.004) for alpha in ALPHAS),
    *((local_errors, PENDULUM, alpha, 0.002) for alpha in ALPHAS),
    (multiplier_guess, TEST1, (1.0, 0.7, 0.9, 1.1), 0.01),
    (multiplier_guess, PENDULUM, (1.0, -1.0, 0.0, 100.0), 0.001),
    *OSCILLATOR,
    *((multipliers, TEST1, alpha, (100, 200, 400, 800)) for alpha in (0.0, -0.3)),
    *((multipliers, PENDULUM, alpha, (500, 1000, 2000, 4000)) for alpha in (0.0, -0.3)),
    (drift, TEST1, 400, REACTIONS),
    (drift, PENDULUM, 2000, REACTIONS),
    (second_order, KNIFE, "velocity-level", "q v mu", (100, 200, 400, 800), IMPLICIT),
    (second_order, DISK, "mixed", "q v mu lam", (1000, 2000, 4000), IMPLICIT + WEIGHTED),
    (second_order, CHAIN, "unconstrained", "q v a", (2000, 4000, 8000), PLAIN),
    (drift, KNIFE, 400, DAMPINGS),
    (drift, DISK, 1000, REACTIONS),
    (end_values, ANDREWS, 12_000),
    (drift, ANDREWS, 12_000, DAMPINGS[1:2]),
)
