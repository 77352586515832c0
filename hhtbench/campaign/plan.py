"""From grids of problems, solvers and tolerances or steps to cells, each with the key of its content."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import Any

from hhtbench.arguments import positive_integer
from hhtbench.campaign.sources import SourceReader
from hhtbench.errors import NotFoundError, ProblemError
from hhtbench.request import make_request
from hhtbench.specs import Spec, canonical, parse_spec

OUTPUTS = 51  # output times: enough for a plot; work is measured by solves without them
AXES = ("rtol", "step", "steps")


@dataclass(frozen=True, kw_only=True)
class Grid:
    """All combinations of problems, solvers and the values of the axes given."""

    problems: tuple[str, ...]
    solvers: tuple[str, ...]
    rtol: tuple[float, ...] = ()
    step: tuple[float, ...] = ()  #: [s]
    steps: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """What to run and how long a cell may take."""

    grids: tuple[Grid, ...]
    outputs: int = OUTPUTS
    max_seconds: float = 20.0  #: of one solve [s]
    repeats: int = 3  #: of the timed solve
    counting: bool = True  #: let solvers that count in a run of their own do so; it may compile once more


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One run to be made."""

    key: str  #: content hash: specs, request, sources, versions
    identity: str  #: hash of specs and request alone: a row of another key and this identity is out of date
    problem: str  #: canonical spec
    solver: str  #: canonical spec
    request: dict[str, Any]  #: as in :class:`~hhtbench.store.rows.RunRow`


def named_campaign(name: str) -> Campaign:
    """The campaign of the file ``hhtbench/campaign/<name>.toml``."""
    folder = files("hhtbench.campaign")
    known = sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))
    if name not in known:
        raise NotFoundError(f"there is no campaign named {name!r}; known: {', '.join(known)}.")
    return read_campaign((folder / f"{name}.toml").read_text(encoding="utf-8"))


def read_campaign(text: str) -> Campaign:
    """A campaign from TOML: fields of :class:`Campaign`, and ``[[grid]]`` tables with the fields of :class:`Grid`."""
    table = tomllib.loads(text)
    grids = tuple(_grid(entry) for entry in table.pop("grid", []))
    _refuse_unknown("campaign", table, Campaign)
    return Campaign(grids=grids, **table)


def plan_cells(campaign: Campaign) -> tuple[Cell, ...]:
    """Every cell once, in the order of problem, solver, tolerance.

    Raises
    ------
    NotFoundError
        A problem or solver of that name does not exist; the text names the closest.
    ProblemError
        A spec or a value of the request cannot be used, or there is nothing to run.
    """
    reader = SourceReader()
    behind: dict[tuple[str, str], dict[str, str]] = {}
    cells: dict[str, Cell] = {}
    for problem, solver, asked in _combinations(campaign):
        if (problem, solver) not in behind:
            behind[problem, solver] = reader.behind(_parse(problem), _parse(solver))
        request = {**asked, "outputs": campaign.outputs, "counting": campaign.counting}
        identity = _digest([problem, solver, request])
        cells.setdefault(
            identity,
            Cell(
                key=_digest([identity, behind[problem, solver]]),
                identity=identity,
                problem=problem,
                solver=solver,
                request={**request, "max_seconds": campaign.max_seconds},  # outside the key: a result holds for any budget
            ),
        )
    if not cells:
        raise ProblemError("there is nothing to run: give problems, solvers and rtol, step or steps.")
    order = list(dict.fromkeys(cell.problem for cell in cells.values()))
    return tuple(sorted(cells.values(), key=lambda cell: order.index(cell.problem)))


def _combinations(campaign: Campaign) -> Iterable[tuple[str, str, dict[str, Any]]]:
    positive_integer("outputs", campaign.outputs)
    positive_integer("repeats", campaign.repeats)
    for grid in campaign.grids:
        for problem in dict.fromkeys(map(canonical, grid.problems)):
            for solver in dict.fromkeys(map(canonical, grid.solvers)):
                for axis in AXES:
                    for value in getattr(grid, axis):
                        request = make_request(**{axis: value, "max_seconds": campaign.max_seconds})
                        yield problem, solver, {"atol": None, **{name: getattr(request, name) for name in AXES}}


def _parse(text: str) -> Spec:
    """The spec; a file it names must exist, but nothing is executed here."""
    spec = parse_spec(text)
    if spec.path is not None and not Path(spec.path).expanduser().is_file():
        raise NotFoundError(f"there is no file {spec.path} in {Path.cwd()}; give the path as seen from there.")
    return spec


def _grid(entry: dict[str, Any]) -> Grid:
    _refuse_unknown("grid", entry, Grid)
    return Grid(**{name: tuple(value) for name, value in entry.items()})


def _refuse_unknown(what: str, table: dict[str, Any], kind: Any) -> None:
    known = [field.name for field in fields(kind)]
    unknown = sorted(set(table) - set(known))
    if unknown:
        raise ProblemError(f"{what}: unknown {', '.join(unknown)}; known: {', '.join(known)}.")


def _digest(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def restrict(campaign: Campaign, problems: Sequence[str], solvers: Sequence[str]) -> Campaign:
    """The part of ``campaign`` on these problems and solvers; an empty list keeps all.

    Raises
    ------
    NotFoundError
        One of them is not in the campaign; the text names the closest that is.
    """
    chosen = {"problem": [canonical(text) for text in problems], "solver": [canonical(text) for text in solvers]}
    for kind, texts in chosen.items():
        there = [canonical(text) for grid in campaign.grids for text in getattr(grid, f"{kind}s")]
        for text in texts:
            if text not in there:
                raise NotFoundError(_not_in_campaign(kind, text, list(dict.fromkeys(there))))

    def kept(texts: tuple[str, ...], some: list[str]) -> tuple[str, ...]:
        return tuple(text for text in texts if not some or canonical(text) in some)

    grids = [
        Grid(
            problems=kept(grid.problems, chosen["problem"]),
            solvers=kept(grid.solvers, chosen["solver"]),
            **{axis: getattr(grid, axis) for axis in AXES},
        )
        for grid in campaign.grids
    ]
    return replace(campaign, grids=tuple(grids))


def _not_in_campaign(kind: str, text: str, there: list[str]) -> str:
    close = get_close_matches(text, there, n=1, cutoff=0.5) or [known for known in there if known.startswith(text)][:1]
    hint = f" Did you mean {close[0]}?" if close else ""
    return f"the campaign has no {kind} {text!r}.{hint} It has: {', '.join(there)}."
