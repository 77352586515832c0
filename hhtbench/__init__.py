"""hhtbench: integrate constrained mechanical systems and choose with evidence how.

Importing the package switches JAX to 64-bit numbers, whether JAX is imported before or after it.  The names below are
imported where they are first used: the command line needs few of them, and JAX takes half a second.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from hhtbench.runtime.jax_settings import settle_jax

if TYPE_CHECKING:
    from hhtbench.advice.selecting import Advice, select
    from hhtbench.advice.trading import Trade, trade
    from hhtbench.api import solve
    from hhtbench.campaign.public import Runs, run
    from hhtbench.catalogue.registry import (
        list_problems,
        list_solvers,
        list_verifications,
        load_problem,
        load_solver,
        load_verification,
    )
    from hhtbench.checks.drift import Drift, measure_drift
    from hhtbench.checks.problem import check
    from hhtbench.linear.statics import Equilibrium, equilibrium
    from hhtbench.linear.vibration import Modes, modes
    from hhtbench.lowering.description import describe
    from hhtbench.lowering.equations import Equations
    from hhtbench.protocol.errors import NotFoundError, ProblemError, Stop
    from hhtbench.protocol.events import Event
    from hhtbench.protocol.lagrange import from_sympy
    from hhtbench.protocol.problem import Motion, Problem
    from hhtbench.protocol.sampled import Sampled
    from hhtbench.protocol.scales import Scales
    from hhtbench.protocol.system import NumpySystem, System, parameter
    from hhtbench.solution.request import Request, plan_steps
    from hhtbench.solution.result import Counters, Ends, Solution, Status

__all__ = [
    "HHT",
    "Advice",
    "Counters",
    "Drift",
    "Ends",
    "Equations",
    "Equilibrium",
    "Event",
    "Modes",
    "Motion",
    "NotFoundError",
    "NumpySystem",
    "Problem",
    "ProblemError",
    "Request",
    "Runs",
    "Sampled",
    "Scales",
    "Solution",
    "Status",
    "Stop",
    "System",
    "Trade",
    "__version__",
    "check",
    "describe",
    "equilibrium",
    "from_sympy",
    "list_problems",
    "list_solvers",
    "list_verifications",
    "load_problem",
    "load_solver",
    "load_verification",
    "measure_drift",
    "modes",
    "parameter",
    "plan_steps",
    "run",
    "select",
    "solve",
    "trade",
]

_MODULES = {  # no module has the name of what is in it: importing it would put the module into the name's place
    "advice.selecting": ("Advice", "select"),
    "advice.trading": ("Trade", "trade"),
    "api": ("solve",),
    "campaign.public": ("Runs", "run"),
    "checks.drift": ("Drift", "measure_drift"),
    "checks.problem": ("check",),
    "linear.statics": ("Equilibrium", "equilibrium"),
    "linear.vibration": ("Modes", "modes"),
    "lowering.description": ("describe",),
    "lowering.equations": ("Equations",),
    "protocol.errors": ("NotFoundError", "ProblemError", "Stop"),
    "protocol.lagrange": ("from_sympy",),
    "protocol.sampled": ("Sampled",),
    "protocol.events": ("Event",),
    "protocol.problem": ("Motion", "Problem"),
    "protocol.scales": ("Scales",),
    "protocol.system": ("NumpySystem", "System", "parameter"),
    "catalogue.registry": (
        *("list_problems", "list_solvers", "list_verifications"),
        *("load_problem", "load_solver", "load_verification"),
    ),
    "solution.request": ("Request", "plan_steps"),
    "solution.result": ("Counters", "Ends", "Solution", "Status"),
}
REGISTERED = ("HHT",)  # under the entry-point group hhtbench.names: hhtbench imports no solver
_HOMES = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in REGISTERED:
        value = import_module(f"{__name__}.catalogue.plugins").load("name", name)
    elif name == "__version__":
        value = import_module("importlib.metadata").version(__name__)
    elif name in _HOMES:
        value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


settle_jax()
