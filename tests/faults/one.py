"""``python -m tests.faults.one CHECKED FIRST`` in a copy of the tree: the checks up to the first that fails, as JSON."""

from __future__ import annotations

import json
import resource
import sys
import warnings
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import hhtbench
from hhtbench.processes import one_blas_thread
from hhtbench.specs import parse_spec
from hhtbench.testing import Check, check_problem, check_solver
from hhtbench.testing.scenes import SCENES
from tests.testing.claims import claims_of

SECONDS = 75  # of processor time: a fault may make a loop endless; without one all checks take a third of it


def loaded(group: str, text: str) -> Any:
    """What a spec names, from this tree: the registry refuses files that are not the installed ones."""
    spec = parse_spec(text)
    (entry,) = entry_points(group=group, name=spec.name)
    return entry.load()(**spec.arguments)


def checks_of(checked: str) -> Iterator[Check]:
    """Those that a fault names."""
    kind, _, name = checked.partition(":")
    solvers = tuple(loaded("hhtbench.solvers", text) for text in ("hht", "projected"))
    if kind == "problem":
        return check_problem(loaded("hhtbench.problems", name), solvers=solvers)
    if kind == "scene":
        return check_problem(SCENES[name]().problem, solvers=solvers)
    return check_solver(loaded("hhtbench.solvers", checked), **claims_of(checked))


def main(checked: str, first: str) -> None:
    """Print {"flagged": name, "message": text, "checks": how many ran}."""
    one_blas_thread()
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 5))
    warnings.simplefilter("ignore")
    root = Path(hhtbench.__file__).parent.parent
    if root != Path.cwd():
        raise SystemExit(f"hhtbench was imported from {root}, not from {Path.cwd()}")
    count, found = 0, {"flagged": "", "message": ""}
    try:
        for check in sorted(checks_of(checked), key=lambda check: not check.name.startswith(first)):
            verdict, count = check.run(), count + 1
            if not verdict.kind.good:
                found = {"flagged": verdict.name, "message": verdict.message}
                break
    except Exception as error:  # noqa: BLE001 - a fault may break what comes before the checks: that is found too
        found = {"flagged": "before the checks", "message": f"{type(error).__name__}: {error}"}
    print(json.dumps({**found, "checks": count}))  # noqa: T201


if __name__ == "__main__":
    main(*sys.argv[1:])
