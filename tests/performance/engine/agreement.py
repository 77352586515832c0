"""Whether repeated measurements come to the same verdicts: whole runs in new processes, with a load beside them or without.

``python -m tests.performance.engine.agreement --only steps,starts [--problems NAME ...] [--runs 10] [--load 2]`` prints the
verdicts of every line and how often the commonest came; the exit code is 1 where that is less than nine of ten.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.performance.engine.__main__ import SECTIONS

WANTED = 0.9  # of the runs
BUSY = "while True: sum(i * i for i in range(10**6))"


def main(arguments: list[str]) -> int:
    """Print the table; 1 where verdicts differ too often."""
    parser = argparse.ArgumentParser(prog="python -m tests.performance.engine.agreement", description=__doc__)
    parser.add_argument("--only", default="steps,starts")
    parser.add_argument("--problems", nargs="*", default=[])
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--load", type=int, default=0, help="busy processes beside the measurement")
    asked = parser.parse_args(arguments)
    found: dict[str, list[tuple[str, float | None]]] = {}
    with loaded(asked.load):
        for number in range(asked.runs):
            for name, line in verdicts(asked.only, asked.problems).items():
                found.setdefault(name, []).append(line)
            sys.stderr.write(f"run {number + 1}: {', '.join(line[-1][0] for line in found.values())}\n")
    apart = False
    for name, lines in found.items():
        counts, values = Counter(verdict for verdict, _ in lines), [value for _, value in lines if value is not None]
        same = counts.most_common(1)[0][1]
        apart = apart or same < WANTED * asked.runs
        said = ", ".join(f"{verdict} {count}" for verdict, count in counts.most_common())
        spread = f"{min(values):9.3g} to {max(values):9.3g}" if values else ""
        sys.stdout.write(f"{same:3} of {asked.runs}  {name:75} {said:30} {spread}\n")
    return int(apart)


@contextmanager
def loaded(count: int) -> Iterator[None]:
    """``count`` busy processes while this lasts."""
    busy = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(count)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def verdicts(only: str, problems: list[str]) -> dict[str, tuple[str, float | None]]:
    """Verdict and value of every line of one run in a new process."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "speed.json"
        command = [sys.executable, "-m", "tests.performance.engine", "--only", only, "--out", str(out)]
        subprocess.run([*command, "--problems", *problems], capture_output=True, check=False)
        speed = json.loads(out.read_text(encoding="utf-8"))
    lines = [line for section in (*SECTIONS, "duels") for line in speed[section]]
    return {_name(line): (line["verdict"], line["value"]) for line in lines}


def _name(line: Mapping[str, Any]) -> str:
    if "kind" in line:
        return f"{line['problem']}, error {line['target']:.0e}, fastest {line['kind']}"
    if "links" in line:
        return f"chain of {line['links']}"
    return str(line.get("what") or ", ".join(line[key] for key in ("scene", "cache") if key in line))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
