"""Which engine makes the steps of a system: the host engine, or compiled loops where its functions become machine code."""

from __future__ import annotations

from typing import Any

from hhtbench.counting import Work
from hhtbench.errors import ProblemError
from hhtbench.lowering import Dynamics, NotNative, derive, route_of
from hhtbench.lowering.dynamics.foreign import foreign
from hhtbench.protocol import DERIVATIVES, NumpySystem, System, declared
from solvers._start import Place, counted_dynamics, dynamics_for, independent, regular
from solvers.hht.choose import choose
from solvers.hht.coefficients import Method
from solvers.hht.engine import HostEngine, layout_of
from solvers.hht.native.engine import NativeEngine
from solvers.hht.native.kernel import Kernel, kernel_for

ENGINES = ("auto", "host", "native")
LARGEST = 200  # unknowns of a step up to which machine code is tried: beyond it the host engine is as fast


def make_engine(
    system: System | NumpySystem,
    method: Method,
    place: Place,
    work: Work,
    *,
    linsolver: str = "auto",
    engine: str = "auto",
) -> HostEngine:
    """The engine for runs that begin at ``place``, without a look at the start.

    Raises
    ------
    ProblemError
        ``engine="native"`` for a system that cannot be compiled; the text says why, and the way out.
    """
    dynamics = counted_dynamics(dynamics_for(system, place), work)
    fallback, reason = _fallback(system, place, work), "asked for"
    if engine != "host":
        try:
            return NativeEngine(dynamics, method, work, fallback, kernel=_kernel(dynamics, method, linsolver, engine))
        except NotNative as error:
            if engine == "native":
                raise ProblemError(f'engine="native" cannot serve this system: {error}. Take engine="auto".') from error
            reason = str(error)
    made = HostEngine(dynamics, method, work, fallback, choice=choose(dynamics, layout_of(dynamics, method), linsolver))
    made.why = f"host: {reason}"
    return made


def _kernel(dynamics: Dynamics, method: Method, linsolver: str, engine: str) -> Kernel:
    if linsolver not in ("auto", "band"):
        raise NotNative(f'linsolver="{linsolver}" is the host engine\'s')
    layout = layout_of(dynamics, method)
    if engine == "auto" and layout.size > LARGEST:
        raise NotNative(f"a step has {layout.size} unknowns, more than {LARGEST}")
    return kernel_for(foreign(dynamics) if route_of(dynamics) == "numpy" else dynamics, method, layout)


def _fallback(system: System | NumpySystem, place: Place, work: Work) -> Any:
    names = tuple(name for name in DERIVATIVES if declared(system, name) is not None)
    if not names:
        return None
    return lambda: counted_dynamics(
        regular(independent(derive(system, place.t, place.q, place.v, ignored=names), place), place), work
    )
