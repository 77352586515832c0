"""hhtbench: integrate constrained mechanical systems and choose with evidence how.

Importing the package switches JAX to 64-bit numbers.
"""

import jax

jax.config.update("jax_enable_x64", True)  # first: arrays made by the imports below must have 64 bits already

from hhtbench.api import solve
from hhtbench.check import check
from hhtbench.describe import describe
from hhtbench.errors import NotFoundError, ProblemError
from hhtbench.protocol import Motion, NumpySystem, Problem, Scales, System, parameter
from hhtbench.registry import list_problems, list_solvers, list_verifications, load_problem, load_solver, load_verification
from hhtbench.request import Request
from hhtbench.result import Counters, Solution, Status

__all__ = [
    "Counters",
    "Motion",
    "NotFoundError",
    "NumpySystem",
    "Problem",
    "ProblemError",
    "Request",
    "Scales",
    "Solution",
    "Status",
    "System",
    "check",
    "describe",
    "list_problems",
    "list_solvers",
    "list_verifications",
    "load_problem",
    "load_solver",
    "load_verification",
    "parameter",
    "solve",
]
