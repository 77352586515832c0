"""``check``: check a problem's shapes, derivatives, start, rank and index."""

from __future__ import annotations

import time

import numpy as np

from hhtbench.checks.problem.conservation import conservation_rows
from hhtbench.checks.problem.data import data_rows, measured_rows
from hhtbench.checks.problem.derivatives import DERIVED, Sample, automatic_derivatives, derivative_rows, given_derivatives
from hhtbench.checks.problem.reference import Probe, References
from hhtbench.checks.problem.rows import attempt, not_measured
from hhtbench.checks.problem.scales import Sizes, sizes_of
from hhtbench.checks.problem.start import Start, consistency_rows, examine, mass_rows, regularity_rows
from hhtbench.checks.problem.survey import Survey, survey
from hhtbench.lowering import Dynamics, Structure, derive
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.evidence import Evidence, Row
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import DERIVATIVES

__all__ = ["check"]

RANDOM_STATES = 3
SEED = 20070101  # fixed: the same problem gives the same rows
NEAR_Q, NEAR_V, NEAR_T = 0.05, 0.5, 0.05  # how far the random states lie from the start, in typical sizes


def check(problem: Problem) -> Evidence:
    """Check what ``problem`` states; every fault is a failing row, none stops the check.

    Derivatives are compared at the start and at seeded random states near it.  A row that cannot be measured
    because an earlier one failed says so and counts as failed.

    Raises
    ------
    TypeError
        ``problem`` is not a Problem (a spec is resolved by ``load_problem``).
    """
    if not isinstance(problem, Problem):
        raise TypeError(f"check takes a Problem; got {type(problem).__name__}. Use load_problem for a spec.")
    began = time.perf_counter()
    shapes = survey(problem)
    rows = [*shapes.rows, *_rows_of_dynamics(problem, shapes), *measured_rows(problem, shapes.faults)]
    return Evidence(title=f"check of {problem.name}", rows=tuple(rows), seconds=time.perf_counter() - began)


def _rows_of_dynamics(problem: Problem, shapes: Survey) -> list[Row]:
    """Return the rows that need the derived functions: derivatives, start, mass, rank, index, data, conservation."""
    place = (problem.system, problem.t_span[0], problem.q0, problem.v0)
    outcome = attempt(lambda: derive(*place, ignored=shapes.untrusted))
    fault = shapes.blocking or outcome.fault
    if fault:
        _, scales = sizes_of(problem, None, None)
        return [*(not_measured(*claim, fault) for claim in BLOCKED), scales]
    dynamics = outcome.value
    s = dynamics.structure
    sizes, scales = sizes_of(problem, s.m, s.p)
    references = References(
        derive(*place, ignored=tuple(DERIVATIVES)), np.concatenate([[sizes.t], sizes.q, sizes.v, sizes.lam, sizes.mu])
    )
    states = _states(problem, s, sizes)
    finite, samples = _samples(dynamics, references, states)
    rows = [finite]
    if finite.passed:
        rows += derivative_rows(dynamics, references, samples, shapes.faults)
    else:
        rows.append(not_measured(*BLOCKED[0], str(finite.measured)))
    wrong = shapes.untrusted + _wrong_derivatives(rows)
    trusted = derive(*place, ignored=wrong) if wrong else dynamics
    start = examine(trusted, problem, sizes) if finite.passed else Start(s, None, None, None, None, str(finite.measured))
    rows += mass_rows(trusted, states, start)
    rows += [
        *consistency_rows(start, problem),
        *regularity_rows(start, "redundant" in problem.tags),
    ]
    rows += conservation_rows(trusted, problem, sizes, states[1:], shapes.faults)
    return [*rows, scales, *data_rows(problem, s.m, s.p, sizes, start)]


BLOCKED = (  # rows that stand for what cannot be measured at all
    ("derivative", "the derivatives agree with the functions", "1e-06 by differences"),
    ("start", "the start is consistent", "1e-08 of the largest coordinate or velocity"),
    ("kkt", "the KKT matrix is regular", "regular"),
    ("index", "the differential index is defined", "0, 2 or 3"),
)


def _states(problem: Problem, s: Structure, sizes: Sizes) -> list[Probe]:
    """Return the start and random states near it."""
    random = np.random.default_rng(SEED)
    multipliers = [
        guess if guess is not None and guess.size == size else scale
        for guess, size, scale in ((problem.lam_guess, s.m, sizes.lam), (problem.mu_guess, s.p, sizes.mu))
    ]
    first = np.concatenate([[problem.t_span[0]], problem.q0, problem.v0, *multipliers])
    near = [NEAR_T * sizes.t, *(NEAR_Q * sizes.q), *(NEAR_V * sizes.v), *(NEAR_V * sizes.lam), *(NEAR_V * sizes.mu)]
    points = [first] + [first + near * random.uniform(-1.0, 1.0, first.size) for _ in range(RANDOM_STATES)]
    forward = 1.0 if problem.t_span[1] >= problem.t_span[0] else -1.0
    for point in points[1:]:
        point[0] = first[0] + forward * abs(point[0] - first[0])  # a force may be undefined before the start
    return [Probe(point, random.uniform(0.5, 1.5, s.n)) for point in points]


def _samples(dynamics: Dynamics, references: References, states: list[Probe]) -> tuple[Row, list[Sample]]:
    """Evaluate references and given derivatives at every state where the system is defined; the start must be one."""
    given = given_derivatives(dynamics)
    automatic = automatic_derivatives(references)
    samples, fault, left_out = [], "", 0
    for i, state in enumerate(states):
        label = "at the start" if i == 0 else f"at random state {i}"
        outcome = attempt(lambda state=state: references.at(state))  # type: ignore[misc]
        reason = outcome.fault or _nonfinite(outcome.value.value)
        if reason:
            fault = fault or (reason if i == 0 else "")
            left_out += 1
        else:
            samples.append(Sample(label, state, outcome.value, given(state), automatic(state)))
    measured = f"finite at {len(samples)} of {len(states)} states"
    if left_out and not fault:
        measured += "; the others are left out"
    claim = "every function is finite at the start"
    row = Row(id="start/finite", claim=claim, measured=fault or measured, bound="finite", passed=not fault)
    return row, samples


def _nonfinite(values: dict[str, Vector]) -> str:
    """Name the first component that is NaN or infinite; empty string if there is none."""
    for name, value in values.items():
        if not np.all(np.isfinite(value)):
            i = int(np.flatnonzero(~np.isfinite(value))[0])
            function = {"mass_product": "mass_matrix, row", "constraint_velocity": "dg/dt"}.get(name, name)
            return f"{function}[{i}] = {value[i]}"
    return ""


def _wrong_derivatives(rows: list[Row]) -> tuple[str, ...]:
    """Return the declared derivatives whose rows fail; the following rows are measured without them."""
    names = [row.id.removeprefix("derivative/") for row in rows if row.passed is False and "/" in row.id]
    return tuple({DERIVED[name].declared_as for name in names if name in DERIVED and DERIVED[name].declared_as})
