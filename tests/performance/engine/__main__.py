"""``python -m tests.performance.engine [--quick] [--only starts,steps,...] [--problems NAME ...] [--folder FOLDER]``."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import hhtbench  # noqa: F401 - 64 bit before anything else
from hhtbench.campaign.machine import machine_facts
from hhtbench.protocol.evidence import plain
from tests.performance.chain import measure_chains
from tests.performance.engine.clock import BROKEN
from tests.performance.engine.compiling import measure_compiling
from tests.performance.engine.contest import QUICK, measure_contest
from tests.performance.engine.limits import measure_evaluations, measure_memory, measure_middle
from tests.performance.engine.page import page, printed
from tests.performance.engine.starts import measure_starts
from tests.performance.engine.steps import measure_steps

FOLDER = Path("reports/latest")
FAILED = 1
SECTIONS: dict[str, Callable[[], list[dict[str, Any]]]] = {
    "steps": measure_steps,
    "compiling": measure_compiling,
    "chains": measure_chains,
    "starts": measure_starts,
    "middle": measure_middle,
    "evaluations": measure_evaluations,
    "memory": measure_memory,
}
CONTEST = "contest"


def main(arguments: list[str]) -> int:
    """Measure, print, write; 1 where a limit is broken."""
    asked = _parse(arguments)
    chosen = asked.only.split(",") if asked.only else [*SECTIONS, CONTEST]
    asked.folder.mkdir(parents=True, exist_ok=True)
    problems = QUICK if asked.quick else tuple(asked.problems)
    contest = {CONTEST: lambda: measure_contest(problems, asked.folder / "contest.sqlite")}
    started = time.monotonic()
    speed: dict[str, Any] = {"schema": 3, "quick": asked.quick, "environment": machine_facts()}
    speed["created"] = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    for name, measure in (SECTIONS | contest).items():
        if name in chosen:
            speed[name] = measure()
            sys.stderr.write(f"{name}: {time.monotonic() - started:.0f} s since the start\n")
    speed["seconds"] = time.monotonic() - started
    (asked.folder / "speed.json").write_text(json.dumps(plain(speed), indent=1), encoding="utf-8")
    (asked.folder / "speed.html").write_text(page(speed, compared=(asked.folder / "index.html").is_file()), encoding="utf-8")
    sys.stdout.write(printed(speed) + f"\nwritten: {asked.folder / 'speed.html'}\n")
    return FAILED if any(line["verdict"] == BROKEN for name in SECTIONS for line in speed.get(name, ())) else 0


def _parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.performance.engine", description=__doc__)
    parser.add_argument("--quick", action="store_true", help=f"the contest on {', '.join(QUICK)} only")
    parser.add_argument("--only", default="", help=f"some of {','.join([*SECTIONS, CONTEST])}")
    parser.add_argument("--problems", nargs="*", default=[], help="the contest on these problems only")
    parser.add_argument("--folder", type=Path, default=FOLDER, help=f"[default: {FOLDER}]")
    asked = parser.parse_args(arguments)
    unknown = set(filter(None, asked.only.split(","))) - {*SECTIONS, CONTEST}
    if unknown:
        parser.error(f"there is no section {', '.join(sorted(unknown))}")
    return asked


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
