"""Which code computes a form's functions: one table for all libraries.

===================================  =======================================  =======================================
system                               residual F, right-hand side y'           Jacobians
===================================  =======================================  =======================================
plain callables                      NumPy                                    full matrices, NumPy
up to FULL unknowns n + m + p        code of full matrices                    full matrices, the same
larger, mass of few entries          code of products                         entries, likewise; dy'/dy of constrained
                                                                              systems is full
larger, any other mass               code of full matrices                    full matrices, the same; dy'/dy by XLA
===================================  =======================================  =======================================

A mass of few entries is the identity, diagonal, or regular with entries in a narrow band.  One that varies is taken so from
:data:`~hhtbench.lowering.dynamics.matrix_free.SMALL` unknowns on, and not in the underlying ODE of a system without
constraints, whose y' is divided by it.

Code is machine code, of more than 5,000 operations in loops, or XLA's where that would be too long or does not know a
primitive.  The accelerations of larger constrained systems are solved with the entries of the KKT matrix, by
:class:`~solvers.forms.eliminated.Eliminated`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from hhtbench.lowering import Dynamics, compile_function
from hhtbench.lowering.dynamics.products import is_larger, paying_products
from solvers.forms.layout import Functions, Layout, jacobian_function, residual_along, residual_function
from solvers.forms.underlying import rhs_along, rhs_function, rhs_jacobian_function

if TYPE_CHECKING:
    from hhtbench.lowering.compile.coloured import OftenCalled
    from hhtbench.lowering.dynamics.matrix_free import MatrixFree

MAX_FILL = 0.3  # share of nonzero entries above which a sparse factorisation takes longer than a full one


def dae_functions(dynamics: Dynamics, layout: Layout) -> Functions:
    """Residual and Jacobian of a DAE form, by the code that the table names."""
    products = paying_products(dynamics)
    if products is None:
        jacobian = compile_function(jacobian_function, dynamics, layout)
        return Functions(compile_function(residual_function, dynamics, layout), jacobian)
    residual, size = compile_function(residual_function, products, layout), layout.size
    entries = _sparse(residual_along, products, layout, example=(np.zeros(size), 0.0, np.zeros(size), np.zeros(size), 0.0))
    if entries is None:
        return Functions(residual, compile_function(jacobian_function, dynamics, layout))
    packed = entries.packed
    return Functions(residual, lambda t, y, yp, c: packed(y, float(t), y, yp, float(c))[size:], entries.pattern)


def ode_functions(dynamics: Dynamics) -> Functions:
    """Right-hand side and Jacobian of the underlying ODE, by the code that the table names."""
    s = dynamics.structure
    if not s.linear_reaction or (is_larger(dynamics) and s.constrained):
        from solvers.forms.eliminated import eliminated_functions  # with the compiled loops, which most systems do without

        return eliminated_functions(dynamics)
    products = paying_products(dynamics)
    if products is not None and products.entries is not None and not s.constrained:
        products = None  # y' is divided by such a mass, and differentiated
    route = "xla" if is_larger(dynamics) and products is None else None  # machine code of full ones takes 9 s at 60 unknowns
    jacobian = compile_function(rhs_jacobian_function, dynamics, route=route)
    if products is None:
        return Functions(compile_function(rhs_function, dynamics), jacobian)
    rhs, size = compile_function(rhs_function, products), 2 * dynamics.structure.n
    entries = _sparse(rhs_along, products, example=(np.zeros(size), 0.0))
    if entries is None:
        return Functions(rhs, jacobian)
    packed = entries.packed
    return Functions(rhs, lambda t, y: packed(y, float(t))[size:], entries.pattern)


def _sparse(
    function: Callable[..., Any], products: MatrixFree, *static: Any, example: tuple[Any, ...]
) -> OftenCalled | None:
    """``function`` with the entries of its derivative; None if its pattern is too full or cannot be read."""
    try:
        found = products.often_called(function, *static, example=example)
    except NotImplementedError:  # a primitive of which neither the graph nor asdex knows the sparsity
        return None
    return None if found.pattern.rows.size > MAX_FILL * example[0].size ** 2 else found
