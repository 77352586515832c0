"""HHT beside Exudyn's generalised-alpha at equal error, in turn, on scenes with the same equations.

Both are refined until the error is reached, with the settings that make each fastest.  A solve of ours is ``HHT.solve`` with
its start and its output at the end, one of theirs ``SolveSystem`` of a system that is ready.  The errors of both are against
the certified reference, at its rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from itertools import product
from typing import Any

import numpy as np
from tabulate import tabulate

from hhtbench.campaign.accuracy import compare as compared
from hhtbench.protocol.problem import Problem
from problems import bushing_chain, cable_pendulum, spinup_beam
from solvers.hht import HHT
from tests.performance.engine.clock import compare, once
from tests.performance.wing.exudyn_scenes import Settings, Theirs, exudyn

TARGETS = (1e-2, 1e-3)
LIMIT = 0.5  # of our time over Exudyn's
PATIENCE = 20.0  # seconds of each comparison
REPEATS = 3  # solves of each setting that is tried, beside the first
LONG = 0.3  # seconds of a solve that is not repeated
HALVINGS = 3  # of the interval, in logarithms, in which a setting just reaches an error: to 9 %
UNIT = 40  # of numbers of steps: the rows of the references lie at their ends
MOST = 2**16  # steps, or one over the tolerance times 16
ALPHAS, RHOS = (-0.05, -0.3), (0.9, 0.5)
PROBLEMS: Mapping[str, Callable[[], Problem]] = {
    "spinup_beam, 10 s": partial(spinup_beam.problem, t_end=10.0),
    "bushing_chain, c = 3.5e3": partial(bushing_chain.problem, c=3.5e3),
    "bushing_chain, c = 3.5e6": partial(bushing_chain.problem, c=3.5e6),
    "cable_pendulum, plane": cable_pendulum.problem,
}
Way = tuple[str, Callable[[], object]]  # the text of a setting, and one solve with it


def least(error: Callable[[int], float], target: float) -> int | None:
    """Return about the smallest fineness, a multiple of ``UNIT``, whose error is at most ``target``; None up to ``MOST``."""
    fine = UNIT
    while error(fine) > target:
        fine *= 2
        if fine > MOST:
            return None
    coarse = fine // 2
    for _ in range(HALVINGS if fine > UNIT else 0):
        middle = UNIT * round(math.sqrt(coarse * fine) / UNIT)
        if middle in (coarse, fine):
            break
        coarse, fine = (coarse, middle) if error(middle) <= target else (middle, fine)
    return fine


class Ours:
    """HHT on one problem with error control or with equal steps."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.solvers = {alpha: HHT(problem.system, alpha=alpha) for alpha in ALPHAS}
        self.error = cache(self._error)

    def solve(self, alpha: float, how: str, fine: int, t_eval: Any = None) -> Any:
        """One solve of fineness ``fine``: that many steps, or a tolerance of ``1 / fine``."""
        asked: dict[str, Any] = {"steps": fine} if how == "steps" else {"rtol": 4.0 / fine}
        rows = self.problem.t_span if t_eval is None else t_eval
        return self.solvers[alpha].solve(self.problem.t_span, self.problem.q0, self.problem.v0, t_eval=rows, **asked)

    def _error(self, alpha: float, how: str, fine: int) -> float:
        reference: Any = self.problem.reference
        found = self.solve(alpha, how, fine, reference["t"])
        if not found.success:
            return math.inf
        rows: Any = compared(self.problem, found)
        return float(np.max([rows.scaled(name) for name in ("q", "v")]))

    def way(self, how: str, target: float) -> Way | None:
        """Return the fastest solve that just reaches the error, of several alphas; None if none does."""
        found: dict[str, Callable[[], object]] = {}
        for alpha in ALPHAS:
            fine = least(partial(self.error, alpha, how), target)
            if fine is not None:
                text = f"{fine} steps" if how == "steps" else f"rtol {4.0 / fine:.2g}"
                found[f"alpha {alpha}, {text}"] = partial(self.solve, alpha, how, fine)
        return min(found.items(), key=lambda way: _seconds(way[1]), default=None)


def their_way(theirs: Theirs, target: float) -> Way | None:
    """Return the fastest solve of Exudyn that just reaches the error: of two dampings, Newton methods, tolerances of these
    and linear solvers.  Each damping with each Newton method has the least number of steps of its own.
    """
    found: dict[str, tuple[Settings, float]] = {}
    for rho, modified in product(RHOS, (True, False)):
        steps = least(partial(_their_error, theirs, rho, modified), target)
        if steps is None:
            continue
        for newton, linear in product((1e-8, 1e-4), ("EigenSparse", "EXUdense")):
            one = Settings(steps=steps, rho=rho, modified=modified, newton=newton, linear=linear)
            text = f"rho {rho}, {steps} steps, {'modified' if modified else 'full'} Newton to {newton:g}, {linear}"
            found[text] = one, _seconds(partial(theirs.solve, theirs.settings(one)))
    for text, (one, _) in sorted(found.items(), key=lambda item: item[1][1]):
        if theirs.error(one) <= target:  # a loose Newton iteration may miss it
            return text, partial(theirs.solve, theirs.settings(one))
    return None


def _their_error(theirs: Theirs, rho: float, modified: bool, steps: int) -> float:
    return theirs.error(Settings(steps=steps, rho=rho, modified=modified))


def _seconds(solve: Callable[[], object]) -> float:
    """Return the least processor time of a solve [s]; a long one runs once."""
    first = once(solve).cpu
    return first if first > LONG else min(first, *(once(solve).cpu for _ in range(REPEATS)))


def line(name: str, target: float, ours: Ours, theirs: Theirs) -> list[str]:
    """Compare the fastest ways of both on one scene."""
    ways = {"ours": ours.way("rtol", target), "equal steps": ours.way("steps", target)}
    ways["Exudyn"] = their_way(theirs, target)
    there = {who: way for who, way in ways.items() if way is not None}
    missing = [who for who in ways if who not in there]
    text = "; ".join([f"{who}: {way[0]}" for who, way in there.items()] + [f"{who} does not reach it" for who in missing])
    if "Exudyn" not in there or len(there) < 2:
        return [name, f"{target:g}", *["-"] * 5, text]
    found = compare(
        {who: way[1] for who, way in there.items()},
        lambda took: min(took[who] for who in there if who != "Exudyn") / took["Exudyn"],
        LIMIT,
        PATIENCE,
    )
    times = [f"{1e3 * found.cpu(who):.2f}" if who in there else "-" for who in ways]
    ratio = f"{found.figure.value:.2f} [{found.figure.low:.2f}, {found.figure.high:.2f}]"
    return [name, f"{target:g}", *times, ratio, found.figure.verdict(LIMIT), text]


def comparisons() -> Iterator[str]:
    """Yield the table, or why there is none."""
    if exudyn is None:
        yield "Exudyn is not installed: no comparison with it."
        return
    lines = []
    for name, make in PROBLEMS.items():
        problem = make()
        ours, theirs = Ours(problem), Theirs(problem)
        lines += [line(name, target, ours, theirs) for target in TARGETS]
    heads = [
        "",
        "error",
        "HHT [ms]",
        "HHT, equal steps [ms]",
        "Exudyn [ms]",
        "the faster of ours over Exudyn",
        f"at most {LIMIT}",
        "",
    ]
    yield f"Exudyn {exudyn.__version__}, generalised-alpha of index 3, times of `SolveSystem` and of `HHT.solve`"
    yield tabulate(lines, headers=heads, tablefmt="github", disable_numparse=True)
