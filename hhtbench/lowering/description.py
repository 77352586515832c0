"""``describe``: a system's declarations, what need not be computed, route and linear algebra, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from tabulate import tabulate

from hhtbench.lowering import (
    Dynamics,
    Structure,
    derive,
    route_of,
    routes,
    singular_at,
    too_large,
)
from hhtbench.lowering.compile.routes import MAX_COMPILED
from hhtbench.lowering.dynamics.kkt import AccelerationLevel
from hhtbench.lowering.dynamics.matrix_free import SMALL
from hhtbench.lowering.dynamics.products import large, matrix_free
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import DECLARABLE, PHYSICS, NumpySystem, System, declared

WIDTHS = [None, 32, 52, 52]  # characters a column of the table
MAX_SHOWN = 6  # entries of a parameter array shown; for a larger one its shape


@dataclass(frozen=True)
class Statement:
    """One line of a description: subject, statement and reason."""

    topic: str  #: "declared", "not computed", "computed", "route", "linear algebra" or "size"
    subject: str
    text: str
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class Description:
    """Result of :func:`describe`; prints as a table."""

    title: str
    statements: tuple[Statement, ...]

    def about(self, topic: str) -> tuple[Statement, ...]:
        """The statements of one topic."""
        return tuple(statement for statement in self.statements if statement.topic == topic)

    def as_dict(self) -> dict[str, Any]:
        """Plain Python values: ``{title, statements: [{topic, subject, text, reason}]}``."""
        rows = [{f.name: getattr(statement, f.name) for f in fields(statement)} for statement in self.statements]
        return {"title": self.title, "statements": rows}

    def __str__(self) -> str:
        body, last = [], ""
        for statement in self.statements:
            topic = "" if statement.topic == last else statement.topic
            body.append([topic, statement.subject, statement.text, statement.reason])
            last = statement.topic
        table = tabulate(body, headers=["", "what", "", "because"], maxcolwidths=WIDTHS, disable_numparse=True)
        return f"{self.title}\n\n{table}"


def describe(what: Problem | System | NumpySystem) -> Description:
    """Describe a problem, or a system as far as that is possible without a start.

    Raises
    ------
    ProblemError
        A declared function returns the wrong shape; ``check`` lists them all.
    TypeError
        ``what`` is none of the three.
    """
    if isinstance(what, Problem):
        system, title = what.system, f"{what.name}: {type(getattr(what.system, 'inner', what.system)).__name__}"
        rows = [*_declared(system), *_of_problem(what)]
    elif isinstance(what, (System, NumpySystem)):
        system, title = what, type(what).__name__
        rows = [*_declared(system), *_undeclared(system), *_without_start(system), _route(system)]
    else:
        raise TypeError(f"describe takes a Problem, a System or a NumpySystem; got {type(what).__name__}.")
    return Description(title=title, statements=tuple(rows))


def _declared(system: System | NumpySystem) -> list[Statement]:
    layout = declared(system, "layout")
    if layout is not None:
        text = f"{layout.states} states, {layout.inputs} inputs, {layout.waiting} samples on their way"
        further = Statement("declared", "states, inputs", text, "each is one more coordinate, which n counts")
        return [*_declared(declared(system, "inner")), further]
    rows = []
    for name in DECLARABLE:
        value = declared(system, name)
        if value is not None:
            rows.append(Statement("declared", name, _first_line(value) if callable(value) else _shown(value)))
    if isinstance(system, System):
        for field in fields(system):
            if field.name not in DECLARABLE:
                doc = field.metadata.get("doc", "")
                rows.append(Statement("declared", field.name, f"= {_shown(getattr(system, field.name))}", doc))
    return rows


def _first_line(function: Any) -> str:
    text = (getattr(function, "__doc__", None) or "").strip()
    return text.splitlines()[0] if text and getattr(function, "__name__", "") else "a function"


def _shown(value: Any) -> str:
    if hasattr(value, "items"):
        return ", ".join(value)
    if not hasattr(value, "shape"):
        return str(value)
    array = np.asarray(value)
    return np.array2string(array, precision=6, separator=", ") if array.size <= MAX_SHOWN else f"array {array.shape}"


def _undeclared(system: System | NumpySystem) -> list[Statement]:
    """List the quantities that are not computed because constraints, mass, energy or invariants are not declared."""
    absent = {name: declared(system, name) is None for name in PHYSICS}
    rows = []
    if absent["constraint"]:
        rows.append(
            Statement("not computed", "lam, g, g_q", "no multiplier lam, no position rows", "no constraint is declared")
        )
    if absent["velocity_constraint"]:
        rows.append(
            Statement(
                "not computed", "mu, k, k_v", "no multiplier mu, no velocity rows", "no velocity_constraint is declared"
            )
        )
    if absent["constraint"] and absent["velocity_constraint"]:
        rows.append(Statement("not computed", "KKT matrix", "accelerations are M^-1 F", "without constraints it is an ODE"))
    if absent["mass_matrix"]:
        rows.append(Statement("not computed", "M", "no mass is factorised", "no mass_matrix is declared: identity"))
    for name in ("energy", "invariants"):
        if absent[name]:
            rows.append(Statement("not computed", name, "not measured", f"no {name} is declared; solvers never use it"))
    return rows


def _of_problem(problem: Problem) -> list[Statement]:
    t, q, v = problem.t_span[0], problem.q0, problem.v0
    dynamics = derive(problem.system, t, q, v)
    s = dynamics.structure
    singular = singular_at(dynamics, t, q)
    rows = [*_undeclared(problem.system), *_dependencies(dynamics, singular), *_derivatives(dynamics), _reaction(s)]
    size = f"n = {s.n} coordinates, m = {s.m} position constraints, p = {s.p} velocity constraints"
    rows.append(Statement("size", "n, m, p", size, "from q0 and what the constraints return"))
    rows += _routes(dynamics, t, q, v)
    return [*(row for row in rows if row is not None), *_linear_algebra(dynamics, singular)]


def _dependencies(dynamics: Dynamics, singular: bool) -> list[Statement]:
    """Statements on derivatives that are not computed because a function does not depend on an argument."""
    s: Structure = dynamics.structure
    rows = []
    if s.mass == "constant" and not singular:
        reason = _switch("the mass does not depend on t or q", "mass")
        rows.append(Statement("not computed", "M(t, q), (M x)_q", "the mass is constant: factorised once", reason))
    if declared(dynamics.system, "force_jacobians") is None:
        for uses, letter in ((s.force_uses_q, "q"), (s.force_uses_v, "v")):
            if not uses:
                reason = f"the force does not depend on {letter}"
                rows.append(Statement("not computed", f"F_{letter}", f"F_{letter} is zero", reason))
    if s.m and not s.rheonomic:
        rows.append(Statement("not computed", "g_t", "g_t is zero", "the constraint does not depend on t"))
    if s.reaction_uses_v:
        text = "the reaction takes v: the end reaction of HHT's steps is an unknown, its velocity that of the end"
        rows.append(Statement("computed", "Q_v", text, "reaction is declared as a function of (t, q, v, lam)"))
    if s.p and not s.velocity_reaction_uses_v:
        text = "the velocity reaction's derivative by v is zero"
        rows.append(Statement("not computed", "Q_v", text, "the velocity reaction does not depend on v"))
    if route_of(dynamics) == "numpy":
        reason = "plain callables cannot be read: every function may depend on all its arguments"
        rows.append(Statement("computed", "dependencies", "no derivative is taken to be zero", reason))
    return rows


def _derivatives(dynamics: Dynamics) -> list[Statement]:
    """Statements on where each derivative comes from: declared, automatic, or by differences."""
    s: Structure = dynamics.structure
    needed = ["force_jacobians"] if s.force_uses_q or s.force_uses_v else []
    needed += ["constraint_jacobian"] if s.m else []
    needed += ["constraint_time_derivative"] if s.m and s.rheonomic else []
    needed += ["constraint_acceleration"] if s.m else []
    needed += ["velocity_constraint_jacobian"] if s.p else []
    needed += ["reaction_jacobians"] if s.m else []
    given = [name for name in needed if declared(dynamics.system, name) is not None]
    missing = [name for name in needed if name not in given]
    rows = []
    if given:
        rows.append(Statement("computed", ", ".join(given), "called as declared", "they are declared"))
    if missing and route_of(dynamics) == "xla":
        rows.append(Statement("computed", ", ".join(missing), "by automatic differentiation", "they are not declared"))
        if declared(dynamics.system, "sparsity"):
            text = "used for the matrices of large systems; full ones take no pattern"
            rows.append(Statement("computed", "sparsity", text, "it is declared, and compared at the start"))
    elif missing:
        coloured = "coloured " if declared(dynamics.system, "sparsity") else ""
        text = f"by {coloured}differences; constraints then hold to about 1e-9, not to roundoff"
        rows.append(Statement("computed", ", ".join(missing), text, "they are not declared"))
    return rows


def _reaction(s: Structure) -> Statement | None:
    if not s.constrained:
        return None
    if s.linear_reaction:
        reason = _switch("the reaction is linear in lam and mu", "reaction")
        return Statement("computed", "multipliers", "by one linear solve", reason)
    reason = "the reaction is nonlinear in a multiplier, or is a callable that cannot be read; the guess picks the root"
    return Statement("computed", "multipliers", "by Newton's iteration from lam_guess, mu_guess", reason)


def _without_start(system: System | NumpySystem) -> list[Statement]:
    text = "not known: sizes need a start (describe a Problem)"
    mass = declared(system, "mass_matrix")
    if mass is not None and not callable(mass) and np.ndim(mass) > 0:
        return [Statement("size", "n, m, p", f"n = {np.shape(mass)[0]}; m and p {text}", "n is that of the mass matrix")]
    return [Statement("size", "n, m, p", text, "functions show their sizes only when they are called")]


def _route(system: System | NumpySystem) -> Statement:
    if isinstance(system, System):
        text = "native (machine code) for a small system, else xla"
        return Statement("route", "native or xla", text, "functions in jax.numpy are traced; sizes need a start")
    return Statement(
        "route", "numpy", "called as they are, from Python", "the functions are plain callables on NumPy arrays"
    )


ROUTE_TEXTS = {"native": "straight-line machine code by LLVM", "xla": "compiled by XLA"}


def _routes(dynamics: Dynamics, t: float, q: Any, v: Any) -> list[Statement]:
    """Statements on the route of the acceleration level and of every function of this dynamics called before."""
    if route_of(dynamics) == "numpy":
        return [_route(dynamics.system)]
    s: Structure = dynamics.structure
    if too_large(dynamics, MAX_COMPILED) is None:
        AccelerationLevel(dynamics).terms(t, q, v, np.zeros(s.n + s.m + s.p))
    taken: dict[tuple[str, str], list[str]] = {}
    for choice in routes(dynamics):
        size = "" if choice.operations is None else f" ({choice.operations} operations)"
        functions = taken.setdefault((choice.route, choice.reason), [])
        functions += [choice.function + size] * (choice.function + size not in functions)
    if not taken:
        return [Statement("route", "xla", ROUTE_TEXTS["xla"], str(too_large(dynamics, MAX_COMPILED)))]
    return [
        Statement("route", route, f"{ROUTE_TEXTS[route]}: {', '.join(functions)}", reason)
        for (route, reason), functions in taken.items()
    ]


def _linear_algebra(dynamics: Dynamics, singular: bool) -> list[Statement]:
    s: Structure = dynamics.structure
    rows = []
    if singular:
        text = "augmented: M + C^T R C takes its place" if s.constrained else "the accelerations are not determined"
        rows.append(Statement("linear algebra", "mass", text, "the mass is singular at the start"))
        s = replace(s, mass="variable")
    if s.constrained:
        size = s.n + s.m + s.p
        kind = "sparse LU (SuperLU)" if large(dynamics) is not None else "dense LU (LAPACK)"
        text = f"{kind} of the KKT matrix, {size} x {size} = n + m + p"
        rows.append(Statement("linear algebra", "acceleration level", text, "gives accelerations and multipliers at a time"))
    if large(dynamics) is not None and s.constrained:
        reason = "where pivots of the KKT matrix at the start are of roundoff"
        rows.append(Statement("linear algebra", "redundant rows", "by the null space of C^T, sparse LU (SuperLU)", reason))
    kind, reason = "dense LU (LAPACK)", _step_reason(s)
    if route_of(dynamics) != "numpy":
        kind = "the inverse or band LU where HHT's steps are machine code, else dense LU (LAPACK)"
    if matrix_free(dynamics) is not None and s.n + 2 * s.m + (s.n + s.p if s.p else 0) >= SMALL:
        kind = "band LU after reverse Cuthill-McKee, or SuperLU where the band is wide,"
        reason += f"; {SMALL} unknowns or more: entries by coloured derivatives, their places read off the computation"
    reason += "; hht(linsolver=dense) takes dense LU"
    rows.append(Statement("linear algebra", "HHT step", f"{kind} of the step matrix, {_step_size(s)}", reason))
    text = "only those of the step matrix that vary are computed, only those that are not zero are kept"
    rows.append(Statement("linear algebra", "entries", text, _switch("the others are read off its computation", "zeros")))
    return rows


def _switch(reason: str, name: str) -> str:
    """``reason`` for a reduction, followed by the HHT option that switches it off."""
    return f"{reason}; hht(without={name}) does not use it"


def _step_size(s: Structure) -> str:
    size = s.n + 2 * s.m + (s.n + s.p if s.p else 0)
    most = size + (s.n if s.m else 0)
    if s.reaction_uses_v:
        return f"{most} x {most}"
    if most == size or s.mass != "variable":
        return f"{size} x {size}" + (f" ({most} x {most} for b != 0)" if most > size else "")
    return f"{most} x {most} ({size} x {size} with a predictor reaction and b = 0)"


def _step_reason(s: Structure) -> str:
    unknowns = ["a"] + (["the stage multipliers lam0, lam1"] if s.m else []) + (["the stage reaction and mu"] if s.p else [])
    reason = f"the unknowns are {' and '.join(unknowns)}"
    return f"{reason}; the end reaction too where it cannot be eliminated" if s.m else reason
