"""Projection of states between steps onto both constraint levels, (H47): many in one compiled call, else one by one."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext, suppress
from functools import partial
from typing import Any

import numpy as np

from hhtbench.lowering import Dynamics, NotNative
from hhtbench.lowering.caching import Cache, by_id
from hhtbench.lowering.dynamics.matrix_free import MatrixFree, conjugate
from hhtbench.lowering.dynamics.products import paying_products
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import BudgetSpent
from solvers._dense import OnConstraints
from solvers._projection import OneByOne, ProjectionFailure, near
from solvers.hht.run.engine import Engine
from solvers.hht.run.functions import Functions, MachineCode
from solvers.kernel import memory as mem
from solvers.kernel.blocks import FEW, FIRST, in_blocks
from solvers.kernel.full import Places, of_full_matrices
from solvers.kernel.kkt import by_entries, places_of, reacts_across
from solvers.kernel.memory import copied
from solvers.kernel.projection import project

_known = Cache(16)  # memory of the loops for one system, or None where no machine code serves


def put_on_constraints(engine: Engine, t: Vector, q: Matrix, v: Matrix, sizes: Vector) -> ProjectionFailure:
    """Project q and v (k, n) at the times ``t`` (k,) in place, as work for output; returns the failures.

    Nothing is projected for methods whose steps satisfy the position level only: rows would look better than steps.
    ``sizes`` (2n,): typical sizes of q and v, by which violations are measured.
    """
    work, clock = engine.work, engine.work.clock
    if not (t.size and engine.structure.constrained and engine.method.coefficients.both_levels):
        return ProjectionFailure()
    with work.for_output():
        work.add("residual_evaluations", engine.points * t.size)
        functions = None if engine.plain else engine.functions
        return project_rows(engine.dynamics, functions, t, q, v, sizes, lambda: clock.left() >= 0.0)


def projection_of(engine: Engine) -> Callable[[Any], OnConstraints]:
    """Function that makes the projection of dense output from the steps, when the run is over."""
    functions = engine.functions if engine.functions.alone else None
    return partial(_projection, engine.dynamics, functions, held=engine.method.coefficients.both_levels)


def _projection(dynamics: Dynamics, functions: Functions | None, steps: Any, *, held: bool) -> OnConstraints:
    return OnConstraints(dynamics, partial(_put_later, dynamics, functions), steps, held=held)


def _put_later(dynamics: Dynamics, functions: Functions | None, t: Vector, q: Matrix, v: Matrix, sizes: Vector) -> str:
    """:func:`project_rows` without the run's counts and budgets; returns a warning or ""."""
    return str(project_rows(dynamics, functions, t, q, v, sizes))


def project_rows(
    dynamics: Dynamics,
    functions: Functions | None,
    t: Vector,
    q: Matrix,
    v: Matrix,
    sizes: Vector,
    going: Callable[[], bool] = lambda: True,
) -> ProjectionFailure:
    """Project q and v (k, n) in place while ``going()``, by machine code of ``functions`` where there is some."""
    done = np.zeros(t.size, dtype=bool)
    found = None
    if functions is not None and (t.size >= FEW or functions.alone):
        with suppress(BudgetSpent):  # nothing more can be compiled
            found = _memory_for(functions)
    if found is not None and functions is not None:
        packed, callbacks = np.concatenate([t[:, None], q, v], axis=1), functions.callbacks
        call = project.following(copied(found.memory), found.mass.copy(), sizes)
        with callbacks or nullcontext():
            in_blocks(
                t.size,
                FIRST if functions.alone else FEW,
                lambda block: call(packed[block], done[block]),
                lambda: going() and (callbacks is None or callbacks.cause is None),
            )
        cause = None if callbacks is None else callbacks.take_cause()
        if cause is not None and not isinstance(cause, BudgetSpent):  # rows that were reached are handed over all the same
            raise cause
        moved_q, moved_v = np.split(packed[:, 1:], 2, axis=1)
        done &= near(q, moved_q, sizes)
        q[done], v[done] = moved_q[done], moved_v[done]
    return OneByOne(dynamics).project_rows(np.flatnonzero(~done), t, q, v, sizes, going)


def _memory_for(functions: Functions) -> Places | None:
    """Memory of the compiled projection, cached; None if it is not machine code."""
    found: Places | None = _known.find(by_id(functions), lambda: _memory(functions))
    return found


def _memory(functions: Functions) -> Places | None:
    if not isinstance(functions, MachineCode):
        return None
    try:
        full = functions.level_codes()  # the way of the steps' functions
        found = of_full_matrices(functions.dynamics) if full else smallest_changes(functions.dynamics)
    except NotNative:
        return None
    found.memory.i[mem.CALLS_PYTHON] = functions.callbacks is not None
    return found


def smallest_changes(dynamics: Dynamics) -> Places:
    """Compiled projection along the constraint Jacobian, also where declared reactions have another direction.

    Raises
    ------
    NotNative
        The functions cannot be machine code.
    """
    products = dynamics if isinstance(dynamics, MatrixFree) else paying_products(dynamics)
    if products is None or not reacts_across(dynamics):
        return places_of(dynamics)
    return by_entries(conjugate(products))
