"""``python -m tests.performance.engine [--quick] [--only steps,compiling,chains,runs] [--out FILE]``."""

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
from hhtbench.campaign.metrics import plain
from tests.performance.engine.compiling import measure_compiling
from tests.performance.engine.field import QUICK, measure_field
from tests.performance.engine.ours import ENGINE
from tests.performance.engine.small_chains import measure_chains
from tests.performance.engine.steps import measure_steps
from tests.performance.engine.table import printed

OUT = Path("reports/latest/speed.json")
FAILED = 1


def main(arguments: list[str]) -> int:
    """Measure, print, write; 1 where a limit is broken."""
    asked = _parse(arguments)
    sections: dict[str, Callable[[], list[dict[str, Any]]]] = {
        "steps": measure_steps,
        "compiling": measure_compiling,
        "chains": measure_chains,
        "runs": lambda: measure_field(QUICK if asked.quick else tuple(asked.problems)),
    }
    started = time.monotonic()
    speed: dict[str, Any] = {"schema": 1, "engine": ENGINE, "quick": asked.quick, "environment": machine_facts()}
    speed["created"] = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    for name, measure in sections.items():
        chosen = not asked.only or name in asked.only.split(",")
        sys.stderr.write(f"{name} ...\n" if chosen else "")
        speed[name] = measure() if chosen else []
    speed["seconds"] = time.monotonic() - started
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    asked.out.write_text(json.dumps(plain(speed), indent=1) + "\n", encoding="utf-8")
    sys.stdout.write(printed(speed) + f"\nwritten: {asked.out}\n")
    return FAILED if any(line.get("holds") is False for name in sections for line in speed[name]) else 0


def _parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.performance.engine", description=__doc__)
    parser.add_argument("--quick", action="store_true", help=f"the contest on {', '.join(QUICK)} only")
    parser.add_argument("--only", default="", help="some of steps,compiling,chains,runs")
    parser.add_argument("--problems", nargs="*", default=[], help="the contest on these problems only")
    parser.add_argument("--out", type=Path, default=OUT, help=f"[default: {OUT}]")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
