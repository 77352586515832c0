"""Checks of solvers and problems for users: every check is an entry of a registry, with its id, claim and known failures.

``check_solver("my_solver.py:solver")`` yields some hundred named checks, ``check_problem(problem)`` those of a problem;
``parametrize_with_checks`` turns them into tests, and ``pytest --hhtbench-solver=NAME`` does so without a file.  pytest is
imported only by the last two.  The form of an entry is in :mod:`.entry`, the list in :mod:`.registry`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hhtbench.conformance.check import Check, assert_solver_converges, check_names, check_problem, check_solver
    from hhtbench.conformance.collected import parametrize_with_checks
    from hhtbench.conformance.entry import Kind, Outcome
    from hhtbench.conformance.pairwise import Agreement, agreement, assert_solvers_agree

_MODULES = {
    "check": ("Check", "assert_solver_converges", "check_names", "check_problem", "check_solver"),
    "entry": ("Kind", "Outcome"),
    "pairwise": ("Agreement", "agreement", "assert_solvers_agree"),
    "collected": ("parametrize_with_checks",),
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
