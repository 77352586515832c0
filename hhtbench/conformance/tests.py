"""Run the tests that cover rows of the matrix and report their result."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
MAX_SECONDS = 1800.0  # for the tests of a row


def run_tests_named(tests: tuple[str, ...], run: bool) -> tuple[str, str, tuple[str, ...]]:
    """Return the kind of outcome, pytest's summary, and the tests that fail.

    Tests come with a clone, not with an installed package; unless ``run`` is set and they exist, they are only named.  A
    skipped test shows nothing.
    """
    named = ", ".join(tests)
    there = all((ROOT / test.partition("::")[0]).is_file() for test in tests) and importlib.util.find_spec("pytest")
    if not (run and there):
        return "elsewhere", named, ()
    asked = [sys.executable, "-m", "pytest", "-q", "-ra", "-m", "", "-p", "no:cacheprovider", *tests]
    try:
        done = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=False, timeout=MAX_SECONDS)
    except subprocess.TimeoutExpired:
        return "hung", f"not over after {MAX_SECONDS:g} s: {named}", tests
    lines = (done.stdout.strip() or done.stderr.strip() or "pytest said nothing").splitlines()
    kind = "wrong" if done.returncode else "in_part" if "skipped" in lines[-1] else "right"
    skipped = "".join(f"; not shown: {line}" for line in lines if line.startswith("SKIPPED "))
    failing = tuple(line.split()[1] for line in lines if line.startswith(("FAILED ", "ERROR ")))
    return kind, f"{lines[-1].strip('= ')}: {named}{skipped}", failing
