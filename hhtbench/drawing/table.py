"""Write the table of all registered problems into a Markdown file, between two marks."""

from __future__ import annotations

import inspect
import math
from pathlib import Path
from typing import Any

import jax
import numpy as np

from hhtbench.campaign.reference.plan import Entry, registered_plans
from hhtbench.catalogue import plugins
from hhtbench.catalogue.registry import THUMBNAILS, list_problems, load_problem
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import System, declared

BEGIN, END = "<!-- table: hhtbench show --table -->", "<!-- end of table -->"
HEADS = ("", "name and parameters", "n/m/p", "tags", "values to compare with", "source", "good for")
WIDE = 120  # pixels of a thumbnail in the table


def update_table(file: Path) -> None:
    """Replace the table between the marks of ``file``.

    Raises
    ------
    ProblemError
        The file cannot be read or lacks a mark.
    """
    before, _, after = split_text(file)
    file.write_text(f"{before}{BEGIN}\n{problem_table()}{END}{after}", encoding="utf-8")


def split_text(file: Path) -> tuple[str, str, str]:
    """Split the file into the text before, between and after the marks."""
    try:
        text = file.read_text(encoding="utf-8")
    except OSError as error:
        raise ProblemError(f"{file.name} cannot be read: {error}.") from error
    before, begun, rest = text.partition(BEGIN)
    table, ended, after = rest.partition(END)
    if not begun or not ended:
        raise ProblemError(f"{file.name} must hold the lines {BEGIN} and {END}, the table goes between them.")
    return before, table, after


def problem_table() -> str:
    """Return the table with one row per registered problem, sorted by name."""
    plan = registered_plans()
    rows = [HEADS, ("---",) * len(HEADS), *(_row(name, plan) for name in list_problems())]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _row(name: str, plan: dict[str, Entry]) -> tuple[str, ...]:
    problem = load_problem(name)
    picture = f'<img src="{THUMBNAILS}/{name}.png" width="{WIDE}" alt="{name}">' if problem.sketch else "no sketch"
    cells = (
        picture,
        f"`{name}({_parameters(name)})`",
        "/".join(map(str, _sizes(problem))),
        ", ".join(problem.tags),
        _values(name, problem, plan),
        problem.source,
        problem.good_for.rstrip("."),
    )
    return tuple(cell.replace("|", "\\|") for cell in cells)


def _parameters(name: str) -> str:
    """Return names and default values as text; numbers have four digits."""
    found = inspect.signature(plugins.load("problem", name)).parameters.values()
    return ", ".join(f"{p.name}={_short(p.default)}" for p in found)


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _sizes(problem: Problem) -> tuple[int, int, int]:
    """Return the numbers of coordinates, position constraints and velocity constraints (n, m, p)."""
    t, q, v = problem.t_span[0], problem.q0, problem.v0
    g, k = (declared(problem.system, name) for name in ("constraint", "velocity_constraint"))
    return q.size, _size(problem, g, t, q), _size(problem, k, t, q, v)


def _size(problem: Problem, rows: Any, *at: Any) -> int:
    """Return how many ``rows`` there are; JAX need not compile them to say so."""
    if rows is None:
        return 0
    return math.prod(jax.eval_shape(rows, *at).shape) if isinstance(problem.system, System) else np.size(rows(*at))


def _values(name: str, problem: Problem, plan: dict[str, Entry]) -> str:
    """Describe the closed solution and the certified references of a problem."""
    texts = ["closed solution"] if problem.exact is not None else []
    entries = [entry for entry in plan.values() if entry.spec.partition("(")[0] == name]
    if entries:
        times = sorted({t for entry in entries for t in entry.times})
        many = f"{len(entries)} certified references" if len(entries) > 1 else "certified reference"
        texts.append(f"{many}, t = {', '.join(f'{t:g}' for t in times)}")
    return "; ".join(texts) or "none"
