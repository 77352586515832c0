"""Compare the derivatives that the solvers use, declared or derived, with references that use none of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any

import numpy as np

from hhtbench.checks.problem.deviation import USABLE, Derivative, by_differences, deviation, of_one_size
from hhtbench.checks.problem.reference import Probe, Reference, References, part_rows, parts_of, split
from hhtbench.checks.problem.rows import attempt, not_measured
from hhtbench.lowering import Dynamics, Structure, compile_function, route_of
from hhtbench.lowering.dynamics.dynamics import evaluate
from hhtbench.protocol.arguments import Matrix
from hhtbench.protocol.evidence import Row

DIFFERENCE_BOUND = 1e-6
FIRST_ORDER_BOUND = 1e-4  # first-order differences serve Newton's matrix only, where four digits are plenty
EXACT_BOUND = 1e-12  # bound on deviations from automatic differentiation
# A deviation is relative to the largest term of its row plus a floor: so much of all that enters the row's function,
# since where a derivative vanishes only roundoff of those terms is left.
DIFFERENCE_FLOOR = 1e-5
NESTED_FLOOR = 1e-2  # the reference is a difference of differences
DERIVED_FLOOR = 1.0  # what is judged comes from differences too
EXACT_FLOOR = 1e-2


SYMBOLS = {
    "force": "F",
    "mass_product": "M x",
    "constraint": "g",
    "constraint_velocity": "g",
    "velocity_constraint": "k",
    "reaction": "Q",
    "velocity_reaction": "the velocity reaction",
}


DERIVED: dict[str, Derivative] = {
    "force_q": Derivative("force_jacobians", "F_q", "force", "q", "force_jacobians", 0),
    "force_v": Derivative("force_jacobians", "F_v", "force", "v", "force_jacobians", 1),
    "mass_product_q": Derivative("", "(M x)_q", "mass_product", "q", "mass_product_jacobian"),
    "constraint_q": Derivative(
        "constraint_jacobian", "g_q", "constraint", "q", "constraint_jacobian", first_order=False
    ),
    "constraint_t": Derivative(
        "constraint_time_derivative", "g_t", "constraint", "t", "constraint_time_derivative", first_order=False
    ),
    "constraint_velocity_q": Derivative(
        "", "(g_t + g_q v)_q", "constraint_velocity", "q", "constraint_velocity_jacobian",
        rests_on=("constraint_q", "constraint_t"),
    ),
    "constraint_acceleration": Derivative(
        "constraint_acceleration", "g_tt + 2 g_tq v + g_qq(v, v)", "constraint_velocity", "motion",
        "constraint_acceleration", rests_on=("constraint_q", "constraint_t"), first_order=False,
    ),
    "velocity_constraint_v": Derivative(
        "velocity_constraint_jacobian", "k_v", "velocity_constraint", "v", "velocity_constraint_jacobian", first_order=False
    ),
    "velocity_constraint_q": Derivative("", "k_q", "velocity_constraint", "q", "velocity_constraint_position_jacobian"),
    "velocity_constraint_acceleration": Derivative(
        "", "k_t + k_q v", "velocity_constraint", "motion", "velocity_constraint_acceleration", first_order=False
    ),
    "reaction_q": Derivative(
        "reaction_jacobians", "Q_q", "reaction", "q", "reaction_jacobians", 0, rests_on=("constraint_q",)
    ),
    "reaction_v": Derivative("reaction_jacobians", "Q_v", "reaction", "v", "reaction_jacobians", 1),
    "reaction_lam": Derivative(
        "reaction_jacobians", "Q_lam", "reaction", "lam", "reaction_jacobians", 2, rests_on=("constraint_q",)
    ),
    "velocity_reaction_v": Derivative(
        "", "Q_v", "velocity_reaction", "v", "velocity_reaction_jacobians", 0, rests_on=("velocity_constraint_v",)
    ),
    "velocity_reaction_mu": Derivative(
        "", "Q_mu", "velocity_reaction", "mu", "velocity_reaction_jacobians", 1, rests_on=("velocity_constraint_v",)
    ),
}  # fmt: skip


def _value(d: Dynamics, derivative: Derivative, at: dict[str, Any]) -> Any:
    """Evaluate one derivative at the arguments ``at``; zero if the solvers know that it is zero."""
    s = d.structure
    if derivative.member == "constraint_time_derivative" and not s.rheonomic:
        return d.xp.zeros(s.m)
    value = evaluate(d, derivative.member, at)
    value = value if derivative.entry is None else value[derivative.entry]
    return d.xp.zeros((s.n, s.n)) if value is None else value


@dataclass(frozen=True)
class Sample:
    """Reference and given derivatives at one state."""

    label: str
    state: Probe
    reference: Reference
    given: dict[str, Matrix | str]  #: derivative -> (rows, columns), or why there is none
    automatic: dict[str, Matrix | str]  #: declared derivatives as automatic differentiation gives them


def names_of(s: Structure) -> tuple[str, ...]:
    """Return the names of the derivatives that a system of this structure has."""
    parts, none = parts_of(s), () if s.reaction_uses_v else ("reaction_v",)
    return tuple(name for name, derivative in DERIVED.items() if derivative.part in parts and name not in none)


def packed_derivatives(d: Dynamics, names: tuple[str, ...], z: Any, x: Any) -> Any:
    """Evaluate the derivatives ``names`` at z and concatenate them, flattened, in one vector."""
    at = split(d.structure, z) | {"x": x}
    return d.xp.concatenate([d.xp.asarray(_value(d, DERIVED[name], at), dtype=float).ravel() for name in names])


def _shape(s: Structure, name: str) -> tuple[int, int]:
    derivative = DERIVED[name]
    sizes = {"t": 1, "motion": 1, "q": s.n, "v": s.n, "lam": s.m, "mu": s.p}
    return part_rows(s, derivative.part), sizes[derivative.by]


def given_derivatives(dynamics: Dynamics, names: tuple[str, ...] = ()) -> Callable[[Probe], dict[str, Matrix | str]]:
    """Return a function of the state that evaluates the derivatives ``names`` (default: all), or the reason of a failure."""
    s = dynamics.structure
    names = names or names_of(s)
    if route_of(dynamics) == "xla":
        compiled = compile_function(packed_derivatives, dynamics, names)
        bounds = np.cumsum([np.prod(_shape(s, name)) for name in names])[:-1]
        return lambda state: {
            name: flat.reshape(_shape(s, name))
            for name, flat in zip(names, np.split(compiled(state.z, state.x), bounds), strict=True)
        }

    def one_by_one(state: Probe) -> dict[str, Matrix | str]:
        found: dict[str, Matrix | str] = {}
        for name in names:
            outcome = attempt(lambda name=name: packed_derivatives(dynamics, (name,), state.z, state.x))  # type: ignore[misc]
            found[name] = outcome.fault or outcome.value.reshape(_shape(s, name))
        return found

    return one_by_one


def automatic_derivatives(references: References) -> Callable[[Probe], dict[str, Matrix | str]]:
    """Return a function of the state that evaluates declared derivatives by automatic differentiation (JAX systems only)."""
    names = tuple(x for x in names_of(references.structure) if references.declares(DERIVED[x].declared_as))
    return (lambda _: {}) if references.from_differences or not names else given_derivatives(references.plain, names)


def derivative_rows(dynamics: Dynamics, references: References, samples: list[Sample], faulty: dict[str, str]) -> list[Row]:
    """Return one row per derivative; ``faulty`` maps declared derivatives of the wrong shape to the reason."""
    rows: dict[str, Row] = {}
    for name in names_of(dynamics.structure):
        derivative, reason = DERIVED[name], ""
        is_declared = references.declares(derivative.declared_as)
        first_order = derivative.first_order and references.from_differences and not is_declared
        limit = FIRST_ORDER_BOUND if first_order else DIFFERENCE_BOUND
        claim = f"{derivative.text} ({'declared' if is_declared else 'derived'}) agrees with {SYMBOLS[derivative.part]}"
        failed = [f"derivative/{x}" for x in derivative.rests_on if x in rows and rows[x].passed is False]
        if is_declared and derivative.declared_as in faulty:
            reason = f"{derivative.declared_as} is faulty (row shape/{derivative.declared_as})"
        elif failed and not is_declared:
            reason = f"it is made from {' and '.join(failed)}, which {'fails' if len(failed) == 1 else 'fail'}"
        if reason:
            rows[name] = not_measured(f"derivative/{name}", claim, f"{limit:.0e} by differences", reason)
        else:
            rows[name] = _row(name, claim, limit, references, samples)
    return list(rows.values())


def _row(name: str, claim: str, limit: float, references: References, samples: list[Sample]) -> Row:
    derivative, row_id = DERIVED[name], f"derivative/{name}"
    difference, exact, bound = (0.0, ""), (0.0, ""), f"{limit:.0e} by differences"
    floor, judged = _difference_floor(name, references), False
    expected = of_one_size([by_differences(derivative, references, x.reference, x.state) for x in samples])
    for sample, roughly in zip(samples, expected, strict=True):
        given, automatic = sample.given[name], sample.automatic.get(name, "")
        if isinstance(given, str):
            return Row(id=row_id, claim=claim, measured=f"{given} ({sample.label})", bound=bound, passed=False)
        difference = max(difference, deviation(given, roughly, floor, sample.label), key=itemgetter(0))
        if isinstance(automatic, str):
            continue
        if deviation(automatic, roughly, floor, "")[0] <= FIRST_ORDER_BOUND:  # beside a kink it need not agree
            exactly, judged = replace(roughly, matrix=automatic, error=0.0), True
            exact = max(exact, deviation(given, exactly, EXACT_FLOOR, sample.label), key=itemgetter(0))
    good = difference[0] <= limit and exact[0] <= EXACT_BOUND
    blur, where = max((one.blur, sample.label) for one, sample in zip(expected, samples, strict=True))
    if good and not judged and blur > USABLE:
        return _unjudged(name, claim, bound, references, where)
    bound += f" beside their own error of {blur:.0e}" if blur > limit else ""
    bound += f", {EXACT_BOUND:.0e} by automatic differentiation" if judged else ""
    measured = f"{difference[0]:.1e} by differences"
    measured += f", {exact[0]:.1e} by automatic differentiation" if judged else ""
    if difference[0] > limit:
        measured = f"{difference[0]:.1e} by differences ({difference[1]})"
    elif not good:
        measured = f"{exact[0]:.1e} by automatic differentiation ({exact[1]})"
    return Row(id=row_id, claim=claim, measured=measured, bound=bound, passed=good)


def _difference_floor(name: str, references: References) -> float:
    """Return the share of a row's terms that counts beside its derivative, by the number of nested differences."""
    derivative = DERIVED[name]
    if not references.from_differences:
        return DIFFERENCE_FLOOR
    if not (derivative.declared_as and references.declares(derivative.declared_as)):
        return DERIVED_FLOOR
    nested = derivative.part == "constraint_velocity"
    nested |= derivative.part == "reaction" and not references.declares("reaction")
    return NESTED_FLOOR if nested else DIFFERENCE_FLOOR


def _unjudged(name: str, claim: str, bound: str, references: References, where: str) -> Row:
    """Return the row of a derivative for which no step gives reliable differences: not judged, or failed if made of them."""
    derivative = DERIVED[name]
    text = f"differences of {SYMBOLS[derivative.part]} scatter {where}, whatever the step (is it smooth? are scales right?)"
    if not references.from_differences or references.declares(derivative.declared_as):
        return Row(id=f"derivative/{name}", claim=claim, measured=f"not judged: {text}", bound=bound, passed=None)
    advice = f"; declare {derivative.declared_as}" if derivative.declared_as else ""
    return not_measured(f"derivative/{name}", claim, bound, f"{text} and it is made of them{advice}")
