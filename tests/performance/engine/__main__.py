"""``python -m tests.performance.engine [--quick] [--only starts,steps,...] [--problems NAME ...] [--out FILE]``."""

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
from hhtbench.evidence import plain
from tests.performance.engine.clock import BROKEN
from tests.performance.engine.compiling import measure_compiling
from tests.performance.engine.field import GRACE, QUICK, measure_field
from tests.performance.engine.limits import measure_evaluations, measure_memory, measure_middle
from tests.performance.engine.ours import ENGINE
from tests.performance.engine.small_chains import measure_chains
from tests.performance.engine.starts import measure_starts
from tests.performance.engine.steps import measure_steps
from tests.performance.engine.table import printed

OUT = Path("reports/latest/speed.json")
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
CONTEST = "runs"
WHOLE = 715.0  # all sections together on the clock [s]; the contest takes what the others leave


def main(arguments: list[str]) -> int:
    """Measure, print, write; 1 where a limit is broken."""
    asked = _parse(arguments)
    chosen = asked.only.split(",") if asked.only else [*SECTIONS, CONTEST]
    started = time.monotonic()
    speed: dict[str, Any] = {"schema": 2, "engine": ENGINE, "quick": asked.quick, "environment": machine_facts()}
    speed["created"] = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    speed |= {name: [] for name in (*SECTIONS, "runs", "duels")}
    for name in (name for name in SECTIONS if name in chosen):
        speed[name] = SECTIONS[name]()
        sys.stderr.write(f"{name}: {time.monotonic() - started:.0f} s since the start\n")
    if CONTEST in chosen:
        problems = QUICK if asked.quick else tuple(asked.problems)
        speed |= measure_field(problems, WHOLE - GRACE - (time.monotonic() - started))
    speed["seconds"] = time.monotonic() - started
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    asked.out.write_text(text_of(plain(speed)), encoding="utf-8")
    sys.stdout.write(printed(speed) + f"\nwritten: {asked.out}\n")
    return FAILED if any(line["verdict"] == BROKEN for name in SECTIONS for line in speed[name]) else 0


def text_of(speed: dict[str, Any]) -> str:
    """JSON with one line for every entry of a list."""
    parts = []
    for name, value in speed.items():
        entries = [json.dumps(entry) for entry in value] if isinstance(value, list) else None
        text = json.dumps(value) if entries is None else "[\n" + ",\n".join(entries) + "\n]"
        parts.append(f"{json.dumps(name)}: {text}")
    return "{\n" + ",\n".join(parts) + "\n}\n"


def _parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.performance.engine", description=__doc__)
    parser.add_argument("--quick", action="store_true", help=f"the contest on {', '.join(QUICK)} only")
    parser.add_argument("--only", default="", help=f"some of {','.join([*SECTIONS, CONTEST])}")
    parser.add_argument("--problems", nargs="*", default=[], help="the contest on these problems only")
    parser.add_argument("--out", type=Path, default=OUT, help=f"[default: {OUT}]")
    asked = parser.parse_args(arguments)
    unknown = set(filter(None, asked.only.split(","))) - {*SECTIONS, CONTEST}
    if unknown:
        parser.error(f"there is no section {', '.join(sorted(unknown))}")
    return asked


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
