"""Table of the equations of each method, as functions (dynamics, method, layout, x, given).

Those with derivatives have the iterate before as a further argument, after ``x``: 1, then the iterate (size,); or 0 and
anything where the step has none.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from hhtbench.lowering import Structure
from solvers.hht.equations import discretise, newmark
from solvers.hht.equations.coefficients import Method
from solvers.hht.equations.known import Layout


class Equations(NamedTuple):
    """Functions that define one step of a method."""

    layout: Callable[[Structure, Method], Layout]  #: unknowns of a step
    residual_and_ends: Callable[..., Any]  #: residual, q1 and v1, (size + 2n,)
    to_differentiate: Callable[..., Any]  #: the same, for the derivative by x, (H61)
    residual_and_matrix: Callable[..., Any]  #: residual, matrix, dq1/dx and dv1/dx, (size + size*size + 2*n*size,)
    state_after: Callable[..., Any]  #: see :func:`~solvers.hht.equations.corrections.state_after`


EQUATIONS = {
    "hht": Equations(
        discretise.layout,
        discretise.step_residual_and_ends,
        discretise.step_to_differentiate,
        discretise.step_residual_and_matrix,
        discretise.state_after,
    ),
    "newmark": Equations(
        newmark.layout,
        newmark.residual_and_ends,
        newmark.to_differentiate,
        newmark.residual_and_matrix,
        newmark.state_after,
    ),
}


def equations_of(method: Method) -> Equations:
    """The equations of ``method``."""
    return EQUATIONS[method.equations]
