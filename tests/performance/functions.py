"""What one call of the reference solvers' functions costs on planar chains of 1, 2, 4, ... 256 and 1,000 links.

Not a test: ``python -m tests.performance.functions [--links N ...] [--only NAME ...] [--solves]``.  Each line is a function
as a library receives it: through the adapter's guard, at random states near the start.  Times are the least of several
rounds; the table below holds first calls, with tracing and compiling, of F and y' with the start.  What takes longer than a
second is left out at larger sizes.  ``--solves``: milliseconds of an accepted step of whole solves instead.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tabulate import tabulate

import hhtbench as hb
from hhtbench.protocol.problem import Problem
from hhtbench.solution.counting import timed
from hhtbench.solution.request import Request
from problems import planar_chain
from solvers._run import Run
from solvers.forms import FORMS, rhs_function

LINKS = (1, 2, 4, 8, 16, 32, 64, 128, 256, 1000)
LIMITS = {("ode: y'", 32): 0.3e-3, **{(f"{form}: F", 32): 50e-6 for form in FORMS if form != "ode"}}  # [s]
JUMP = 3.0  # between neighbouring sizes up to LARGEST links
LARGEST = 256
SLOW = 1.0  # [s] of a call after which larger systems are left out
ROUNDS, ROUND = 7, 0.02  # and seconds of one
STATES = 8  # at which functions are called in turn
SOLVERS = (
    *(f"ida(form={form})" for form in ("ggl", "index2", "index1")),
    *(f"cvode(method={method})" for method in ("bdf", "adams")),
    *(f"scipy(method={method})" for method in ("Radau", "BDF", "LSODA", "DOP853")),
    *(f"diffrax(method={method})" for method in ("Tsit5", "Kvaerno5")),
    "projected(method=DOP853)",
)
RTOL, FEW, MANY = 1e-4, 20, 60  # steps of two solves, whose difference is that of their steps


@dataclass(frozen=True)
class Cost:
    """Of one function at one size [s]."""

    call: float
    first: float  #: the first call


def main(arguments: list[str]) -> int:
    """Measure and print; 1 where a limit is broken."""
    asked = _parse(arguments)
    measure = solve_costs if asked.solves else function_costs
    found: dict[str, dict[int, Cost]] = {}
    for links in asked.links:
        for name, cost in measure(links, asked.only, {name for name, costs in found.items() if _slow(costs)}):
            found.setdefault(name, {})[links] = cost
        sys.stderr.write(f"{links} links\n")
    sys.stdout.write(printed(found, asked.links, 1e3 if asked.solves else 1e6) + "\n")
    broken = [] if asked.solves else list(violations(found))
    sys.stdout.write("\n".join([*broken, f"{len(broken)} limits broken", ""]))
    return int(bool(broken))


def _slow(costs: dict[int, Cost]) -> bool:
    return max(cost.call for cost in costs.values()) > SLOW


def _chosen(name: str, only: list[str], left_out: Iterable[str]) -> bool:
    return name not in left_out and (not only or any(part in name for part in only))


def function_costs(links: int, only: list[str], left_out: Iterable[str]) -> Iterable[tuple[str, Cost]]:
    """Of every function of the forms, and of the underlying ODE within XLA's code."""
    problem = planar_chain.problem(n_links=links)
    for form in FORMS:
        names = ("y'", "dy'/dy") if form == "ode" else ("F", "dF/dy")
        if not any(_chosen(f"{form}: {name}", only, left_out) for name in names):
            continue
        began = time.perf_counter()
        run = prepared(problem, form)
        started = time.perf_counter() - began
        functions = (run.rhs, run.rhs_jacobian) if form == "ode" else (run.residual, _jacobian(run))
        for name, function in zip(names, functions, strict=True):
            if _chosen(f"{form}: {name}", only, left_out):
                cost = cost_of(function, states(run))
                yield f"{form}: {name}", replace(cost, first=cost.first + started)
                started = 0.0
        if form == "ode" and _chosen("ode: y' in XLA", only, left_out):
            yield "ode: y' in XLA", cost_in_xla(run)


def _jacobian(run: Run) -> Callable[..., Any]:
    """dF/dy + 30 dF/dy', as IDA receives it."""
    return lambda t, y, yp: run.jacobian(t, y, yp, 30.0)


def prepared(problem: Problem, form: str) -> Run:
    """A run before its first step."""
    with timed(None) as clock:
        run = Run("functions", problem, Request(rtol=RTOL), form, clock)
        failure = run._begin()
    if failure is not None:
        raise SystemExit(failure.message)
    return run


def states(run: Run) -> list[tuple[Any, ...]]:
    """Arguments (t, y), or (t, y, y'), near the start."""
    random, start = np.random.default_rng(1), run.start
    near = [(0.0, *(x + 1e-3 * random.normal(size=x.size) for x in (start.y, start.yp))) for _ in range(STATES)]
    return [state[: 2 if run.form.kind == "ode" else 3] for state in near]


def cost_of(function: Callable[..., Any], places: list[tuple[Any, ...]]) -> Cost:
    """Of a call at one place after the other."""
    began = time.perf_counter()
    function(*places[0])
    first = time.perf_counter() - began
    turns = itertools.cycle(places)
    return Cost(_least(lambda: function(*next(turns))), first)


def _least(call: Callable[[], Any]) -> float:
    """Seconds of one call, the least of several rounds."""
    began = time.perf_counter()
    call()
    count = max(1, int(ROUND / (time.perf_counter() - began)))
    rounds = []
    for _ in range(ROUNDS if count > 1 else 3):
        began = time.perf_counter()
        for _ in range(count):
            call()
        rounds.append((time.perf_counter() - began) / count)
    return min(rounds)


def cost_in_xla(run: Run) -> Cost:
    """Of y' in a compiled loop, as diffrax evaluates it."""
    from solvers import _diffrax_loop, _xla_call

    turns, outside, rhs = 20, run.form.outside(False), run.form.rhs
    _xla_call.functions[0] = lambda _, t, y: rhs(float(t), y)

    def of_turn(t: Any, y: Any) -> Any:
        return _diffrax_loop.rhs_outside(0.0, t, y) if outside else rhs_function(run.dynamics, t, y)

    @jax.jit
    def many(y: Any, count: Any) -> Any:
        return jax.lax.fori_loop(0, count, lambda i, x: y + 1e-9 * of_turn(1e-3 * i, x), y)

    def call(count: int) -> None:
        many(jnp.asarray(run.start.y), count).block_until_ready()

    began = time.perf_counter()
    call(1)
    first = time.perf_counter() - began
    return Cost(max(_least(lambda: call(1 + turns)) - _least(lambda: call(1)), 0.0) / turns, first)


def solve_costs(links: int, only: list[str], left_out: Iterable[str]) -> Iterable[tuple[str, Cost]]:
    """Of an accepted step of whole solves."""
    problem = planar_chain.problem(n_links=links)
    for name in SOLVERS:
        if not _chosen(name, only, left_out):
            continue

        def solve(most: int, name: str = name) -> tuple[float, int]:
            began = time.perf_counter()
            found = hb.solve(problem, name, rtol=RTOL, max_num_steps=most, max_seconds=60.0)
            return time.perf_counter() - began, found.counters.steps_accepted

        first, (once, _) = solve(MANY)[0], solve(MANY)
        rounds = [(solve(FEW), solve(MANY)) for _ in range(ROUNDS if once < SLOW else 1)]
        (few, least), (many, most) = (min(pair[i] for pair in rounds) for i in range(2))
        yield name, Cost((many - few) / max(most - least, 1), first)


def printed(found: dict[str, dict[int, Cost]], links: Iterable[int], unit: float) -> str:
    """Both tables."""
    sizes = list(links)
    parts, word = [], {1e3: "ms", 1e6: "us"}[unit]
    for title, part, factor in ((f"one call [{word}]", "call", unit), ("first call [s]", "first", 1.0)):
        rows = [
            [name, *(f"{factor * getattr(costs[size], part):.3g}" if size in costs else "" for size in sizes)]
            for name, costs in found.items()
        ]
        parts.append(f"{title}\n{tabulate(rows, ['links', *map(str, sizes)], 'simple', disable_numparse=True)}\n")
    return "\n".join(parts)


def violations(found: dict[str, dict[int, Cost]]) -> Iterable[str]:
    """Limits that are broken, in words."""
    for name, costs in found.items():
        for links, cost in costs.items():
            limit = LIMITS.get((name, links), np.inf)
            if cost.call > limit:
                yield f"{name}, {links} links: {1e6 * cost.call:.3g} us, more than {1e6 * limit:.3g}"
            half = costs.get(links // 2)
            if half is not None and links <= LARGEST and cost.call > JUMP * half.call:
                yield f"{name}, {links // 2} to {links} links: {cost.call / half.call:.1f} times as long"


def _parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.performance.functions", description=__doc__)
    parser.add_argument("--links", nargs="*", type=int, default=list(LINKS), help="sizes of the chain")
    parser.add_argument("--only", nargs="*", default=[], help="functions, or solvers, whose names hold one of these")
    parser.add_argument("--solves", action="store_true", help="whole solves by every reference solver")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
