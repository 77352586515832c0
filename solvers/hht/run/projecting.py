"""States between steps put onto both levels of the constraints, (H47): many in one call of the loops, else one by one."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext, suppress
from functools import partial
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Work
from hhtbench.errors import BudgetSpent
from hhtbench.lowering import Dynamics, NotNative, native
from hhtbench.lowering.caching import ById, Cache
from hhtbench.lowering.compile.compiling import too_large
from hhtbench.lowering.dynamics.jax_dynamics import Conjugate, MatrixFree, matrix_free
from hhtbench.protocol import declared
from solvers._dense import OnConstraints
from solvers._projection import OneByOne, Unmet, near
from solvers._start import counted
from solvers.hht.equations.local_error import levels
from solvers.hht.linear.analysis import address_of
from solvers.hht.loops import memory as mem
from solvers.hht.loops.memory import Memory, Sizes, allocate, copied, integer_view
from solvers.hht.run.engine import Engine
from solvers.hht.run.functions import Functions, MachineCode, level_functions
from solvers.hht.run.recover import kkt_code, row_memory
from solvers.hht.run.rows import FEW, FIRST, in_blocks
from solvers.hht.step.projection import project

_known = Cache(16)  # memory of the loops for one system, or None where no machine code serves


def put_on_constraints(engine: Engine, t: Vector, q: Matrix, v: Matrix, sizes: Vector) -> Unmet:
    """Move q and v (k, n) at the times ``t`` (k,) onto both levels, as work for output; what could not be moved stays.

    Of methods whose steps are on the position level only nothing is moved: it would look better than the steps.
    ``sizes`` (2n,), typical ones of q and v, measure what is violated.
    """
    work, clock = engine.work, engine.work.clock
    if not (t.size and engine.structure.constrained and engine.method.coefficients.both_levels):
        return Unmet()
    with work.for_output():
        work.add("residual_evaluations", engine.points * t.size)
        functions = None if engine.plain else engine.functions
        return put(engine.dynamics, functions, t, q, v, sizes, lambda: clock.left() >= 0.0)


def projection_of(engine: Engine, steps: Any) -> OnConstraints:
    """What puts dense output through the ``steps`` of ``engine`` onto the constraints, when the run is over."""
    move = partial(_put_later, engine.dynamics, engine.functions if engine.functions.alone else None)
    return OnConstraints(engine.dynamics, move, steps, held=engine.method.coefficients.both_levels)


def _put_later(dynamics: Dynamics, functions: Functions | None, t: Vector, q: Matrix, v: Matrix, sizes: Vector) -> Unmet:
    """:func:`put` without the counts and budgets of the run."""
    return put(counted(dynamics, Work()), functions, t, q, v, sizes)


def put(
    dynamics: Dynamics,
    functions: Functions | None,
    t: Vector,
    q: Matrix,
    v: Matrix,
    sizes: Vector,
    going: Callable[[], bool] = lambda: True,
) -> Unmet:
    """The same for ``dynamics``, of whose ``functions`` some may be machine code, as long as it is ``going`` on."""
    done = np.zeros(t.size, dtype=bool)
    found = None
    if functions is not None and (t.size >= FEW or functions.alone):
        with suppress(BudgetSpent):  # nothing more can be compiled
            found = _memory_for(functions)
    if found is not None and functions is not None:
        packed, callbacks = np.concatenate([t[:, None], q, v], axis=1), functions.callbacks
        call = project.following(copied(found[0]), found[1].copy(), sizes)
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
    return OneByOne(dynamics).put(np.flatnonzero(~done), t, q, v, sizes, going)


def _memory_for(functions: Functions) -> tuple[Memory, Vector, Any] | None:
    """For :func:`project`: the loops' memory, a constant mass (none by entries), and what owns the code that is called."""
    found: tuple[Memory, Vector, Any] | None = _known.find(ById(functions), lambda: _memory(functions))
    return found


def _memory(functions: Functions) -> tuple[Memory, Vector, Any] | None:
    dynamics, s = functions.dynamics, functions.layout.structure
    if not isinstance(functions, MachineCode):
        return None
    try:
        if dynamics.matrices and too_large(dynamics) is None:
            (z, codes), mass = level_memory(dynamics), constant_mass(dynamics)
        else:
            across = any(declared(dynamics.system, name) is not None for name in ("reaction", "velocity_reaction"))
            kkt, analysis = kkt_code(conjugate(dynamics)) if across else functions.kkt
            look = native(levels, dynamics, shapes=((), (s.n,), (s.n,)))
            if analysis.kind == "sparse":  # Python would factorise
                return None
            z, codes, mass = row_memory(kkt, analysis, s), (kkt, look), np.zeros(0)
            z.i[mem.C_LEVELS : mem.C_LEVELS + 2] = look.pair
    except NotNative:
        return None
    z.i[mem.CALLS_PYTHON] = functions.callbacks is not None
    return z, mass, codes


def conjugate(dynamics: Dynamics) -> Conjugate:
    """``dynamics`` with reactions normal to the constraints: along declared ones no change is the smallest.

    Raises
    ------
    NotNative
        Its functions are full matrices.
    """
    products = dynamics if isinstance(dynamics, MatrixFree) else matrix_free(dynamics)
    if products is None:
        raise NotNative("full matrices")
    return Conjugate(products.inner, products.constant_mass, products.inverse_mass)


def level_memory(dynamics: Dynamics) -> tuple[Memory, Any]:
    """The loops' memory for acceleration level and projection of a small system, and what owns the code they call.

    Raises
    ------
    NotNative
        Its functions cannot be machine code.
    """
    s = dynamics.structure
    size = s.n + s.m + s.p
    z = allocate(Sizes(n=s.n, m=s.m, p=s.p, size=0, inverse_mass=s.n**2 if s.mass == "variable" else 0, level=size))
    z.i[mem.LINEAR] = s.linear_reaction
    z.i[mem.DGETRF], z.i[mem.DGETRS] = address_of("dgetrf"), address_of("dgetrs")
    integer_view(z, mem.LEVEL_LAPACK)[:] = size, 1, ord("T"), 0
    codes = level_functions(dynamics)
    for name, code in codes.items():
        at = mem.CODE + 2 * mem.FUNCTIONS.index(name)
        z.i[at : at + 2] = code.pair
    return z, codes


def constant_mass(dynamics: Dynamics) -> Vector:
    """M (n*n,), or room for it where it varies."""
    s, mass = dynamics.structure, dynamics.constant_mass
    if s.mass == "variable":
        return np.zeros(s.n**2)
    return np.ravel(np.eye(s.n) if mass is None else np.asarray(mass, dtype=np.float64)).copy()


def sizes_of(q: Any, v: Any, n: int) -> Vector:
    """(2n,) from typical sizes of q and v, each a number or (n,)."""
    sizes = np.empty(2 * n)
    sizes[:n], sizes[n:] = q, v
    return sizes
