"""One step of Newmark-type methods whose accelerations include the reactions, (H36) to (H38) of THEORY.md.

For the methods of the field that the extended HHT is compared with; each has its own file of weights.
Backend-neutral, with the signatures of :mod:`~solvers.hht.equations.discretise`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

from hhtbench.lowering import Dynamics, Structure
from hhtbench.protocol.errors import ProblemError
from solvers.hht.equations.coefficients import Method, NewmarkWeights
from solvers.hht.equations.discretise import accelerate, columns, scaled_mass
from solvers.hht.equations.known import Layout, start_of


class Terms(NamedTuple):
    """Weights of the unknowns and known parts of one step, (H36), (H37)."""

    q: Any  #: (n,) known part of q1
    v: Any  #: (n,) known part of v1
    rate: Any  #: (n,) known part of v'1
    q_a: Any  #: weight of a1 in q1
    v_a: Any  #: weight of a1 in v1
    rate_a: Any = 1.0  #: weight of a1 in v'1
    q_R0: Any = 0.0  #: weight of M^-1 r(t0, q0, .) of the first multiplier in q1
    v_R0: Any = 0.0  #: its weight in v1
    end: float = 1.0  #: weight of the forces and reactions at the end of the step
    earlier: Any = None  #: (n,) weighted forces and reactions at its start; None: not used


class Newmark(NewmarkWeights):
    """Base class of these methods' weights; a approximates v'(t + alpha h)."""

    b: ClassVar[float] = 0.0  #: weight of the end reaction in the position
    total: ClassVar[bool] = True  #: a includes the reactions

    @property
    def both_levels(self) -> bool:
        """True if steps end on both constraint levels, False if on that of positions alone, (H38)."""
        return len(self.multipliers()) > 1

    def multipliers(self) -> tuple[str, ...]:
        """Names of a step's multipliers, (m,) each; the last, "lam1", belongs to the reactions at the end."""
        raise NotImplementedError

    def terms(self, dynamics: Dynamics, start: Mapping[str, Any]) -> Terms:
        """Terms of a step from the state before it, with names of :func:`~solvers.hht.equations.known.start_of`."""
        raise NotImplementedError


class End(NamedTuple):
    """The end of a step as functions of the unknowns."""

    q1: Any  #: (n,)
    v1: Any  #: (n,)
    rate: Any  #: (n,) v'1


def layout(structure: Structure, method: Method) -> Layout:
    """Layout of the unknowns: accelerations and multipliers.

    Raises
    ------
    ProblemError
        The system has velocity constraints, for which these methods are not published.
    """
    if structure.p:
        raise ProblemError(f"this method takes position constraints only; the system has {structure.p} on velocities.")
    return Layout(structure, False, False, multipliers=method.coefficients.multipliers())


def residual_and_ends(dynamics: Dynamics, method: Method, layout: Layout, x: Any, given: Any) -> Any:
    """Residual, q1 and v1, (size + 2n,), for sparse differentiation."""
    step = _Step(dynamics, method, layout, x, given)
    return dynamics.xp.concatenate([*step.rows(), step.end.q1, step.end.v1])


def to_differentiate(dynamics: Dynamics, method: Method, layout: Layout, x: Any, previous: Any, given: Any) -> Any:
    """:func:`residual_and_ends`; the iterate before is not used."""
    return residual_and_ends(dynamics, method, layout, x, given)


def residual_and_matrix(dynamics: Dynamics, method: Method, layout: Layout, x: Any, previous: Any, given: Any) -> Any:
    """Residual, its matrix, dq1/dx and dv1/dx, as :func:`~solvers.hht.equations.discretise.residual_and_matrix`.

    The iterate before is not used.
    """
    xp, step = dynamics.xp, _Step(dynamics, method, layout, x, given)
    q_x, v_x = step.end_derivatives()
    matrix = xp.concatenate(step.matrix_rows(q_x, v_x), axis=0)
    return xp.concatenate([*step.rows(), matrix.ravel(), q_x.ravel(), v_x.ravel()])


def state_after(dynamics: Dynamics, method: Method, layout: Layout, x: Any, given: Any) -> Any:
    """q, v, a, v', lam, v' at the end of the step; zeros instead of stage reactions."""
    step, s = _Step(dynamics, method, layout, x, given), layout.structure
    parts = [step.end.q1, step.end.v1, step.unknown["a"], step.end.rate]
    parts += [step.unknown["lam1"], step.end.rate, dynamics.xp.zeros(2 * s.n)] if s.m else [step.end.rate]
    return dynamics.xp.concatenate(parts)


class _Step:
    """One step, evaluated at an iterate ``x``."""

    def __init__(self, dynamics: Dynamics, method: Method, layout: Layout, x: Any, given: Any) -> None:
        self.dynamics, self.layout, self.unknown = dynamics, layout, layout.split(x)
        self.start = start = start_of(layout, given, dynamics.xp)
        self.terms = terms = method.coefficients.terms(dynamics, start)
        a = self.unknown["a"]
        q1, v1 = terms.q + terms.q_a * a, terms.v + terms.v_a * a  # (H36)
        self.first = next(iter(method.coefficients.multipliers()))
        if self.first != "lam1" and layout.structure.m:
            reaction = dynamics.reaction(start["t"], start["q"], start["v"], self.unknown[self.first])
            reaction = accelerate(dynamics, start, reaction)
            q1, v1 = q1 + terms.q_R0 * reaction, v1 + terms.v_R0 * reaction
        self.end = End(q1, v1, terms.rate + terms.rate_a * a)

    def rows(self) -> list[Any]:
        """Residual rows of forces and constraints, (H37), (H38), scaled as in :mod:`~solvers.hht.equations.discretise`."""
        d, (q1, v1, rate), terms = self.dynamics, self.end, self.terms
        h, t1, s = self.start["h"], self.start["t1"], self.layout.structure
        force = d.force(t1, q1, v1)
        if s.m:
            force = force + d.reaction(t1, q1, v1, self.unknown["lam1"])
        balance = d.mass_product(t1, q1, rate) - terms.end * force  # (H37)
        rows = [accelerate(d, self.start, balance if terms.earlier is None else balance - terms.earlier)]
        if s.m:
            rows.append(d.constraint(t1, q1) * (2.0 / (h * h)))  # (H38)
        if s.m and self.first != "lam1":
            rows.append(d.constraint_velocity(t1, q1, v1) / h)  # (H38)
        return rows

    def end_derivatives(self) -> tuple[Any, Any]:
        """dq1/dx and dv1/dx, (n, size) each, of (H36)."""
        d, terms, eye = self.dynamics, self.terms, self.dynamics.xp.eye(self.layout.structure.n)
        q_blocks, v_blocks = {"a": terms.q_a * eye}, {"a": terms.v_a * eye}
        if self.first != "lam1" and self.layout.structure.m:
            at = self.start["t"], self.start["q"], self.start["v"], self.unknown[self.first]
            by_lam = accelerate(d, self.start, d.reaction_columns(*at))
            q_blocks[self.first], v_blocks[self.first] = terms.q_R0 * by_lam, terms.v_R0 * by_lam
        return columns(d, self.layout, None, **q_blocks), columns(d, self.layout, None, **v_blocks)

    def matrix_rows(self, q_x: Any, v_x: Any) -> list[Any]:
        """Rows of Newton's matrix, by the chain rule through q1 and v1."""
        d, (q1, v1, rate), terms = self.dynamics, self.end, self.terms
        h, t1, s = self.start["h"], self.start["t1"], self.layout.structure
        by_q, by_v = (None if by is None else -terms.end * by for by in d.force_jacobians(t1, q1, v1))
        direct = {"a": terms.rate_a * scaled_mass(d, self.start, t1, q1)}
        parts = [] if by_q is None else [by_q]
        if s.m:
            reaction_q, reaction_v, reaction_lam = d.reaction_jacobians(t1, q1, v1, self.unknown["lam1"])
            parts.append(-terms.end * reaction_q)
            if reaction_v is not None:
                by_v = -terms.end * reaction_v if by_v is None else by_v - terms.end * reaction_v
            direct["lam1"] = -terms.end * accelerate(d, self.start, reaction_lam)
        if s.mass == "variable":
            parts.append(d.mass_product_jacobian(t1, q1, rate))
        chained = [part @ q_x for part in parts] + ([] if by_v is None else [by_v @ v_x])
        row = accelerate(d, self.start, sum(chained[1:], chained[0])) if chained else None
        rows = [columns(d, self.layout, row, **direct)]
        if s.m:
            jacobian = d.constraint_jacobian(t1, q1)
            rows.append((2.0 / (h * h)) * (jacobian @ q_x))
        if s.m and self.first != "lam1":
            velocity_q = d.constraint_velocity_jacobian(t1, q1, v1)
            rows.append((velocity_q @ q_x + jacobian @ v_x) / h)
        return rows
