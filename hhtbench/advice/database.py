"""Database for advice: features of every known problem, and the cost of each solver for each error.

The one that comes with the package is made by ``hhtbench study selection --store FILE --database FILE``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hhtbench.advice.families import family_of
from hhtbench.advice.features import NAMES, Features, Probe
from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.fronts import MEASURES
from hhtbench.campaign.machine import clock_of, machine_facts
from hhtbench.campaign.store import RunRow
from hhtbench.protocol.arguments import Matrix
from hhtbench.protocol.errors import ProblemError

ACCURACIES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
HELD = (None, 1e-10)  #: bounds of the drift: none, and what projection and HHT keep
VERSIONS = ("hhtbench", "numpy", "scipy", "jax", "scikit-sundae")  #: libraries whose versions are stored
PARTS = 100.0  # costs are rounded to this fraction of a decade: 2 %
KIND = {"schema": "hhtbench.advice/1", "accuracies": list(ACCURACIES), "features": list(NAMES)}  # head of a database file
KEYS = {(on, bound): on if bound is None else f"{on}, drift {bound:g}" for on, bound in product(MEASURES, HELD)}


@dataclass(frozen=True)
class Scene:
    """Features and measured costs of one known problem."""

    spec: str
    features: Features
    costs: Mapping[tuple[str, float | None], Matrix]  #: (measure, bound) -> (entries, accuracies); infinite: not reached
    probe_evaluations: float  #: cost of the probe's accelerations in evaluations as in ``costs``
    probe_seconds: float  #: [s]

    @property
    def family(self) -> str:
        """Name of the problem without parameters."""
        return family_of(self.spec)


@dataclass(frozen=True)
class Database:
    """Costs of solvers on known problems."""

    entries: tuple[str, ...]  #: solvers, as the analysis names them
    scenes: tuple[Scene, ...]
    clock: Mapping[str, Any]  #: the machine whose times these are
    versions: Mapping[str, str]
    budget: float  #: [s] that each solver was given on each problem

    @cached_property
    def points(self) -> Matrix:
        """Features of all scenes, (scenes, features)."""
        return np.array([scene.features.vector for scene in self.scenes])

    @cached_property
    def ratios(self) -> Mapping[tuple[str, float | None], NDArray[np.float64]]:
        """(measure, bound) -> costs divided by the cheapest, (scenes, entries, accuracies); NaN where none reaches the
        error.
        """
        costs = {key: np.array([scene.costs[key] for scene in self.scenes]) for key in self.scenes[0].costs}
        with np.errstate(invalid="ignore"):
            return {key: table / table.min(axis=1, keepdims=True) for key, table in costs.items()}

    def refusal(self) -> str:
        """Return why its times do not apply here (another machine, other versions), or ""."""
        why = foreign(self.clock, self.versions)
        return f"the database's times are of {why}" if why else ""

    def of_entries(self, keep: Callable[[str], bool]) -> Database:
        """Return the part with the solvers for which ``keep`` is true."""
        chosen = [index for index, entry in enumerate(self.entries) if keep(entry)]
        scenes = tuple(
            replace(scene, costs={key: table[chosen] for key, table in scene.costs.items()}) for scene in self.scenes
        )
        return replace(self, entries=tuple(self.entries[index] for index in chosen), scenes=scenes)

    def without(self, keep: Callable[[Scene], bool]) -> Database:
        """Return the part with the scenes for which ``keep`` is true."""
        return replace(self, scenes=tuple(scene for scene in self.scenes if keep(scene)))


def foreign(clock: Mapping[str, Any], versions: Mapping[str, Any]) -> str:
    """Describe how machine or libraries of a measured time differ from those here; "" if they do not."""
    facts = machine_facts()
    if clock_of(facts) != dict(clock):
        return f"another machine ({clock.get('processor')}, {clock.get('cores')} cores)"
    other = [f"{name} {said}, here {facts.get(name)}" for name, said in versions.items() if facts.get(name) != said]
    return f"other versions ({'; '.join(other)})" if other else ""


def versions_of(environment: Mapping[str, Any]) -> dict[str, str]:
    """Return the libraries' versions in a row's environment."""
    return {name: str(environment[name]) for name in VERSIONS if name in environment}


def reduced(rows: Sequence[RunRow], probes: Mapping[str, Probe]) -> Database:
    """Reduce rows to the database of all problems that have a probe and on which an error was reached."""
    known = [row for row in analysis.newest(rows).rows if row.problem in probes]
    if not known:
        raise ProblemError("the store holds no row of a problem whose features can be computed.")
    entries, runs = analysis.entries(known), analysis.points(known)
    tables: dict[str, dict[tuple[str, float | None], Matrix]] = {}
    for measure, bound in KEYS:
        for front in analysis.fronts(known, measure, ACCURACIES, bound):
            new = np.full((len(entries), len(ACCURACIES)), np.inf)
            table = tables.setdefault(front.problem, {}).setdefault((measure, bound), new)
            for cost in front.costs:
                table[entries.index(cost.entry), ACCURACIES.index(front.target)] = cost.value
    scenes = []
    for spec, costs in tables.items():
        if np.any(np.isfinite(costs["evaluations", None])):
            call = max([1.0, *(run.call or 1.0 for run in runs if run.problem == spec)])
            scenes.append(Scene(spec, probes[spec].features, costs, call * probes[spec].evaluations, probes[spec].seconds))
    environment = known[0].environment
    return Database(
        entries=tuple(entries),
        scenes=tuple(scenes),
        clock=clock_of(environment),
        versions=versions_of(environment),
        budget=max((run.rules.pair_seconds for run in runs if run.rules is not None), default=math.inf),
    )


def write_database(database: Database, file: Path, command: str) -> None:
    """Write JSON, one scene per line; costs as hundredths of their decimal logarithm, null where not reached."""
    fields = {name: getattr(database, name) for name in ("entries", "clock", "versions", "budget")}
    lines = [json.dumps(_plain(scene), separators=(",", ":")) for scene in database.scenes]
    head = json.dumps({**KIND, "command": command, **fields}, indent=1)[:-2]
    file.write_text(head + ',\n "scenes": [\n' + ",\n".join(lines) + "\n ]\n}\n", encoding="utf-8")


def read_database(file: Path | None = None) -> Database:
    """Read a database from ``file``; None: the one that comes with the package.

    Raises
    ------
    ProblemError
        The file cannot be read or is no such database.
    """
    source = files("hhtbench.advice").joinpath("database.json") if file is None else file
    try:
        stored = json.loads(source.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ProblemError(f"the database {source.name} cannot be read: {error}.") from error
    if not isinstance(stored, dict) or any(stored.get(name) != value for name, value in KIND.items()):
        raise ProblemError(
            f"{source.name} is no database of this hhtbench ({KIND['schema']}); `hhtbench study selection` makes one."
        )
    try:
        found = Database(
            entries=tuple(stored["entries"]),
            scenes=tuple(_scene(line, len(stored["entries"])) for line in stored["scenes"]),
            clock=dict(stored["clock"]),
            versions=dict(stored["versions"]),
            budget=float(stored["budget"]),
        )
        if not found.entries or not found.scenes:
            raise ValueError("it holds no solvers or no scenes")
    except (KeyError, TypeError, ValueError) as error:
        raise ProblemError(f"the database {source.name} is damaged: {type(error).__name__}: {error}.") from error
    return found


def _plain(scene: Scene) -> dict[str, Any]:
    def coded(cost: float) -> int | None:
        return round(PARTS * math.log10(cost)) if math.isfinite(cost) else None

    return {
        "spec": scene.spec,
        "features": [round(float(value), 3) for value in scene.features.vector],
        "probe": [round(scene.probe_evaluations), float(f"{scene.probe_seconds:.2g}")],
        **{KEYS[key]: [[coded(cost) for cost in row] for row in table] for key, table in scene.costs.items()},
    }


def _scene(line: Mapping[str, Any], entries: int) -> Scene:
    def costs(rows: Sequence[Sequence[int | None]]) -> Matrix:
        return np.array([[np.inf if cell is None else 10.0 ** (cell / PARTS) for cell in row] for row in rows])

    tables = {key: costs(line[name]) for key, name in KEYS.items()}
    if shapes := {table.shape for table in tables.values()} - {(entries, len(ACCURACIES))}:
        raise ValueError(f"{line['spec']} has costs of shape {shapes}, not of {entries} solvers by {len(ACCURACIES)} errors")
    return Scene(line["spec"], Features(**dict(zip(NAMES, line["features"], strict=True))), tables, *line["probe"])
