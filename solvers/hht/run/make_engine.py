"""Which functions the loops of a system call."""

from __future__ import annotations

from collections.abc import Callable

from hhtbench.counting import Work
from hhtbench.lowering import derive
from hhtbench.protocol import DERIVATIVES, NumpySystem, System, declared
from solvers._start import Place, counted_dynamics, dynamics_for, independent, regular
from solvers.hht.options import HHTOptions
from solvers.hht.run.engine import Engine
from solvers.hht.run.functions import Functions, functions_for


def make_engine(
    system: System | NumpySystem, options: HHTOptions, place: Place, work: Work, *, controlled: bool = False
) -> Engine:
    """The engine for runs that begin at ``place``, without a look at the start."""
    method, dynamics = options.method(controlled=controlled), counted_dynamics(dynamics_for(system, place), work)
    functions = functions_for(dynamics, method, options.linsolver)
    fallback = None if functions.newton.matrix_cost else _fallback(system, options, place, work, controlled=controlled)
    return Engine(dynamics, method, work, functions, fallback=fallback, plain=options.engine == "python")


def _fallback(
    system: System | NumpySystem, options: HHTOptions, place: Place, work: Work, *, controlled: bool
) -> Callable[[], Functions] | None:
    """Makes functions that trust no declared derivative; None where none is declared."""
    names = tuple(name for name in DERIVATIVES if declared(system, name) is not None)
    if not names:
        return None

    def make() -> Functions:
        derived = regular(independent(derive(system, place.t, place.q, place.v, ignored=names), place), place)
        return functions_for(counted_dynamics(derived, work), options.method(controlled=controlled), options.linsolver)

    return make
