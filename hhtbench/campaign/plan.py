"""Plan a campaign: from grids to pairs of problem and solver, and from a pair's settings to cells with content hashes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta

from hhtbench.campaign.alike import find_alike
from hhtbench.campaign.analysis.cells import Rules, points
from hhtbench.campaign.analysis.ladder import End, next_setting
from hhtbench.campaign.sources import SourceReader
from hhtbench.campaign.store.rows import RunRow
from hhtbench.catalogue.specs import Spec, canonical, parse_spec
from hhtbench.protocol.arguments import positive_integer
from hhtbench.protocol.errors import NotFoundError, ProblemError
from hhtbench.solution.request import make_request

OUTPUTS = 51  # output times: enough for a plot; work is measured by solves without them
AXES = ("rtol", "step", "steps")
BESIDE = ("max_seconds", "rules", "held_out", "reference_file")  # entries of a request that are not part of the key
ACCURACIES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)

Positive = Annotated[float, Meta(gt=0)]
Whole = Annotated[int, Meta(ge=1)]
Accuracy = Annotated[float, Meta(gt=0, lt=1)]
Text = Annotated[str, Meta(min_length=1)]


@dataclass(frozen=True, kw_only=True)
class Grid:
    """All combinations of problems and solvers, refined until the accuracies are reached, or at the settings given."""

    problems: tuple[Text, ...]
    solvers: tuple[Text, ...]
    refine: Literal["rtol", "steps"] = "rtol"  #: what is refined: tolerances, or numbers of equal steps
    held_out: bool = False  #: defaults were not tuned on these problems
    rtol: tuple[Positive, ...] = ()  #: with one of these three nothing is refined
    step: tuple[Positive, ...] = ()  #: [s]
    steps: tuple[Whole, ...] = ()

    @property
    def explicit(self) -> bool:
        """True if the settings are given, so that nothing is refined."""
        return bool(self.rtol or self.step or self.steps)


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """What to run, the errors to reach, and the limits of every solver."""

    grids: tuple[Grid, ...]
    accuracies: tuple[Accuracy, ...] = ACCURACIES  #: achieved scaled errors
    refinements: Whole = 16  #: most solves of one problem by one solver
    max_seconds: Positive = 20.0  #: of one solve [s]
    pair_seconds: Positive = 60.0  #: of all solves of one problem by one solver [s]
    outputs: Whole = OUTPUTS
    repeats: Whole = 3  #: number of timed solves, one in each round over all cells
    counting: bool = True  #: let solvers that count in a run of their own do so; it may compile once more
    reference: Literal["none", "auto"] = "none"  #: "auto": certify what has neither closed solution nor reference


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One run: problem, solver and request, with its content hash."""

    key: str  #: content hash: specs, request, sources, versions
    identity: str  #: hash of specs and request alone: a row of another key and this identity is out of date
    problem: str  #: canonical spec
    solver: str  #: canonical spec
    request: dict[str, Any]  #: as in :class:`~hhtbench.campaign.store.rows.RunRow`


@dataclass(frozen=True, kw_only=True)
class Pair:
    """One problem by one solver: its settings are given, or follow from its rows."""

    problem: str  #: canonical spec
    solver: str  #: canonical spec
    kind: str  #: what is refined, "rtol" or "steps"; "" where the settings are given
    rules: Rules
    behind: Mapping[str, str]  #: files and versions that its results rest on
    fixed: Mapping[str, Any]  #: what every request of the pair holds, inside the key
    held_out: bool = False
    reference: Path | None = None  #: file of the certificate of a problem that brings no reference
    given: tuple[dict[str, Any], ...] = field(default=())  #: the settings, where they are given

    @property
    def name(self) -> tuple[str, ...]:
        """Key of the pair in a plan: problem, solver and what is refined."""
        return self.problem, self.solver, self.kind

    def cell(self, asked: Mapping[str, Any], seconds: float) -> Cell:
        """Return the cell of one setting with the time limit ``seconds`` [s]; limit and rules are not part of its key."""
        request = {"atol": None, **dict.fromkeys(AXES), **asked, **self.fixed}
        identity = _digest([self.problem, self.solver, request])
        beside: dict[str, Any] = {"max_seconds": seconds}
        if self.kind:
            beside["rules"] = {**vars(self.rules), "accuracies": list(self.rules.accuracies)}
        if self.held_out:
            beside["held_out"] = True
        if self.reference is not None:
            beside["reference_file"] = str(self.reference)
        return Cell(
            key=_digest([identity, dict(self.behind)]),
            identity=identity,
            problem=self.problem,
            solver=self.solver,
            request={**request, **beside},
        )

    def next_cells(self, rows: Sequence[RunRow]) -> Sequence[Cell]:
        """Return the cells to run after ``rows``, all of the pair's own so far; none if the pair is finished.

        Nothing else decides: a resumed campaign that holds the rows asks for nothing, and the report calls the same
        function (:mod:`hhtbench.campaign.analysis.ladder`) to explain why an error was not reached.
        """
        if not self.kind:
            return () if rows else tuple(self.cell(asked, self.rules.max_seconds) for asked in self.given)
        found = next_setting(points(rows), self.rules, self.kind)
        if isinstance(found, End):
            return ()
        asked = {"rtol": found.value} if self.kind == "rtol" else {"steps": round(1.0 / found.value)}
        return (self.cell(asked, found.seconds),)


def plan_pairs(campaign: Campaign, references: Mapping[str, Path] | None = None) -> tuple[Pair, ...]:
    """Return every pair of problem and solver, in the order of problems; ``references`` are certificate files by problem.

    Raises
    ------
    NotFoundError
        A problem or solver of that name does not exist; the text names the closest.
    ProblemError
        A spec or a value of the request cannot be used, or there is nothing to run.
    """
    for name in ("outputs", "repeats", "refinements"):
        positive_integer(name, getattr(campaign, name))
    reader = SourceReader()
    behind: dict[tuple[str, str], dict[str, str]] = {}
    pairs: dict[tuple[str, ...], Pair] = {}
    for grid, problem, solver in _combinations(campaign):
        if (problem, solver) not in behind:
            behind[problem, solver] = reader.behind(_parse(problem), _parse(solver))
        kind = "" if grid.explicit else grid.refine
        reference = (references or {}).get(problem)
        known = {} if reference is None else {"reference": _digest(reference.read_text(encoding="utf-8"))}
        found = Pair(
            problem=problem,
            solver=solver,
            kind=kind,
            rules=_rules(campaign),
            behind=behind[problem, solver],
            fixed={"outputs": campaign.outputs, "counting": campaign.counting, **known},
            held_out=grid.held_out,
            reference=reference,
            given=tuple(_given(grid, campaign.max_seconds)),
        )
        before = pairs.setdefault(found.name, found)
        pairs[found.name] = replace(before, given=_once((*before.given, *found.given)))
    if not pairs:
        raise ProblemError("there is nothing to run: give problems, solvers and accuracies, rtol, step or steps.")
    order = list(dict.fromkeys(pair.problem for pair in pairs.values()))
    return tuple(sorted(pairs.values(), key=lambda pair: order.index(pair.problem)))


def outdated(rows: Iterable[RunRow]) -> tuple[RunRow, ...]:
    """Return the rows that differ from today's files and libraries: their key is not that of a cell planned now."""
    reader = SourceReader()
    behind: dict[tuple[str, str], Mapping[str, str]] = {}
    found = []
    for row in rows:
        pair = row.problem, row.solver
        if pair not in behind:
            try:
                behind[pair] = reader.behind(*map(parse_spec, pair))
            except (NotFoundError, ProblemError):  # no longer installed
                behind[pair] = {}
        request = {name: value for name, value in row.request.items() if name not in BESIDE}
        if row.key != _digest([_digest([*pair, request]), dict(behind[pair])]):
            found.append(row)
    return tuple(found)


def _combinations(campaign: Campaign) -> Iterable[tuple[Grid, str, str]]:
    """Yield grid, problem and solver of every cell group; of specs that mean the same the first stands for all."""
    problems, solvers = _first_alike(campaign, "problem"), _first_alike(campaign, "solver")
    for grid in campaign.grids:
        for problem in dict.fromkeys(problems[canonical(text)] for text in grid.problems):
            for solver in dict.fromkeys(solvers[canonical(text)] for text in grid.solvers):
                yield grid, problem, solver


def _first_alike(campaign: Campaign, kind: Literal["problem", "solver"]) -> dict[str, str]:
    """Map every spec of the campaign to the first one that means the same."""
    firsts: dict[str, str] = {}
    for text in dict.fromkeys(canonical(text) for grid in campaign.grids for text in getattr(grid, f"{kind}s")):
        firsts[text] = find_alike(kind, text, dict.fromkeys(firsts.values())) or text
    return firsts


def _rules(campaign: Campaign) -> Rules:
    return Rules(
        accuracies=tuple(sorted({*campaign.accuracies}, reverse=True)),
        max_seconds=campaign.max_seconds,
        pair_seconds=campaign.pair_seconds,
        refinements=campaign.refinements,
    )


def _given(grid: Grid, seconds: float) -> Iterable[dict[str, Any]]:
    for axis in AXES:
        for value in getattr(grid, axis):
            yield {axis: getattr(make_request(**{axis: value, "max_seconds": seconds}), axis)}


def _once(settings: tuple[dict[str, Any], ...]) -> tuple[dict[str, Any], ...]:
    return tuple({json.dumps(asked): asked for asked in settings}.values())


def _parse(text: str) -> Spec:
    """Parse a spec; a file it names must exist, but is not executed."""
    spec = parse_spec(text)
    if spec.path is not None and not Path(spec.path).expanduser().is_file():
        raise NotFoundError(f"there is no file {spec.path} in {Path.cwd()}; give the path as seen from there.")
    return spec


def _digest(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def restrict(campaign: Campaign, problems: Sequence[str], solvers: Sequence[str]) -> Campaign:
    """Return the part of ``campaign`` on these problems and solvers; an empty list keeps all.

    Raises
    ------
    NotFoundError
        One of them is not in the campaign; the text names the closest that is.
    """
    chosen = {"problem": _chosen(campaign, "problem", problems), "solver": _chosen(campaign, "solver", solvers)}

    def kept(texts: tuple[str, ...], some: list[str]) -> tuple[str, ...]:
        return tuple(text for text in texts if not some or canonical(text) in some)

    grids = (
        replace(grid, problems=kept(grid.problems, chosen["problem"]), solvers=kept(grid.solvers, chosen["solver"]))
        for grid in campaign.grids
    )
    return replace(campaign, grids=tuple(grids))


def _chosen(campaign: Campaign, kind: Literal["problem", "solver"], texts: Sequence[str]) -> list[str]:
    """Return the campaign's own canonical specs that mean the same as ``texts``."""
    there = list(dict.fromkeys(canonical(text) for grid in campaign.grids for text in getattr(grid, f"{kind}s")))
    found = [(text, find_alike(kind, text, there)) for text in texts]
    for text, known in found:
        if known is None:
            raise NotFoundError(_not_in_campaign(kind, canonical(text), there))
    return [known for _, known in found if known is not None]


def _not_in_campaign(kind: str, text: str, there: list[str]) -> str:
    close = get_close_matches(text, there, n=1, cutoff=0.5) or [known for known in there if known.startswith(text)][:1]
    hint = f" Did you mean {close[0]}?" if close else ""
    return f"the campaign has no {kind} {text!r}.{hint} It has: {', '.join(there)}."
