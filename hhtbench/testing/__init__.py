"""Checks of solvers and problems that others can run on theirs.

``check_solver("my_solver.py:solver")`` yields some hundred named checks, ``check_problem(problem)`` those of a problem;
``parametrize_with_checks`` makes tests of them, and ``pytest --hhtbench-solver=NAME`` does so without a file.  pytest is
imported only by the last two.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hhtbench.testing.check import Check, Kind, Verdict
    from hhtbench.testing.convergence import assert_solver_converges
    from hhtbench.testing.pairwise import Agreement, agreement, assert_solvers_agree
    from hhtbench.testing.parametrize import parametrize_with_checks
    from hhtbench.testing.problem_checks import check_problem
    from hhtbench.testing.solver_checks import check_names, check_solver

__all__ = [
    "Agreement",
    "Check",
    "Kind",
    "Verdict",
    "agreement",
    "assert_solver_converges",
    "assert_solvers_agree",
    "check_names",
    "check_problem",
    "check_solver",
    "parametrize_with_checks",
]

_MODULES = {
    "pairwise": ("Agreement", "agreement", "assert_solvers_agree"),
    "check": ("Check", "Kind", "Verdict"),
    "convergence": ("assert_solver_converges",),
    "parametrize": ("parametrize_with_checks",),
    "problem_checks": ("check_problem",),
    "solver_checks": ("check_names", "check_solver"),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(f"{__name__}.{_HOMES[name]}")
    value = globals()[name] = getattr(module, name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
