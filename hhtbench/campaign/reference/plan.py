"""Plan of the references to certify: problem, times and the methods that must agree."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from hhtbench.catalogue import plugins
from hhtbench.protocol.errors import NotFoundError, ProblemError, did_you_mean

FIRST = "collocation(form=ggl)"
SECOND = ("projected(method=DOP853)",)
RTOL = 1e-13
SECOND_RTOL = 3e-14  # the others lose more of their tolerance on the way; SciPy takes nothing smaller


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One reference solution to certify."""

    name: str  #: name of its file, without .json
    spec: str  #: the problem, its interval long enough for every time
    times: tuple[float, ...]  #: stated times [s]
    grid: int = 20  #: equal pieces of the interval, for errors along the trajectory; 0: the stated times only
    first: str = FIRST  #: the solver whose values are stored
    second: tuple[str, ...] = SECOND  #: solvers that must agree; the closest of another family and form gives the bar
    rtol: float = RTOL  #: relative tolerance of the first
    second_rtol: float = SECOND_RTOL  #: and of the others
    seconds: float | None = None  #: most wall-clock time of each solve [s]
    note: str = ""  #: why fewer digits are certified than elsewhere
    validate: str = ""  #: what ``validate --all`` takes for the default: where that is singular or long


def load_plan(file: Path) -> dict[str, Entry]:
    """Read the entries of a TOML file, one table ``[name]`` each.

    Raises
    ------
    ProblemError
        The file cannot be read, or an entry lacks spec or times or has an unknown key.
    """
    try:
        tables = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise ProblemError(f"the plan {file.name} cannot be read: {error}.") from error
    return {name: _entry(name, table) for name, table in tables.items()}


def registered_plans() -> dict[str, Entry]:
    """Return the entries of every plan that a distribution registers."""
    found: dict[str, Entry] = {}
    for name in plugins.names("reference"):
        found |= load_plan(plugins.load("reference", name))
    return found


def registered_folder() -> Path:
    """Return the folder of the first registered plan, which holds its reference files."""
    known = plugins.names("reference")
    if not known:
        raise NotFoundError("no distribution registers references; name a folder.")
    return Path(plugins.load("reference", known[0])).parent


def validated_spec(problem: str, plan: dict[str, Entry]) -> str:
    """Return the spec that ``validate --all`` solves for a registered problem: its name, or the plan's replacement."""
    return next((e.validate for e in plan.values() if e.validate and e.spec.partition("(")[0] == problem), problem)


def choose(plan: dict[str, Entry], names: tuple[str, ...]) -> list[Entry]:
    """Return the entries called ``names``, or those of the problems called so; all if ``names`` is empty."""
    found: list[Entry] = []
    for name in names or tuple(plan):
        own = [entry for entry in plan.values() if name in (entry.name, entry.spec, entry.spec.partition("(")[0])]
        if not own:
            hint = did_you_mean(name, plan)
            raise NotFoundError(f"no reference is planned for {name!r}.{hint} Planned: {', '.join(sorted(plan))}.")
        found += [entry for entry in own if entry not in found]
    return found


def _entry(name: str, table: Any) -> Entry:
    known = {field.name for field in fields(Entry)} - {"name"}
    if not isinstance(table, dict) or not {"spec", "times"} <= set(table) <= known:
        raise ProblemError(f"[{name}] of the plan must hold spec and times and may hold {', '.join(sorted(known))}.")
    lists = {key: tuple(table[key]) for key in ("times", "second") if key in table}
    return Entry(name=name, **{**table, **lists})
