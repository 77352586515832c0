"""The registry of checks: every check of a solver is one entry, with its id, what it claims, and what is known to fail.

``check_solver("my_solver.py:solver")`` yields some hundred named checks, ``check_problem(problem)`` those of a problem;
``parametrize_with_checks`` makes tests of them, and ``pytest --hhtbench-solver=NAME`` does so without a file.  pytest is
imported only by the last two.  The form of an entry is in :mod:`.entry`, the list in :mod:`.registry`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hhtbench.conformance.check import Check, check_names, check_problem, check_solver
    from hhtbench.conformance.convergence import assert_solver_converges
    from hhtbench.conformance.entry import Kind, Outcome
    from hhtbench.conformance.pairwise import Agreement, agreement, assert_solvers_agree
    from hhtbench.conformance.parametrize import parametrize_with_checks

_MODULES = {
    "check": ("Check", "check_names", "check_problem", "check_solver"),
    "convergence": ("assert_solver_converges",),
    "entry": ("Kind", "Outcome"),
    "pairwise": ("Agreement", "agreement", "assert_solvers_agree"),
    "parametrize": ("parametrize_with_checks",),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}
__all__ = [
    "Agreement",
    "Check",
    "Kind",
    "Outcome",
    "agreement",
    "assert_solver_converges",
    "assert_solvers_agree",
    "check_names",
    "check_problem",
    "check_solver",
    "parametrize_with_checks",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(f"{__name__}.{_HOMES[name]}")
    value = globals()[name] = getattr(module, name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
