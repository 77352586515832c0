"""A/A: every solver of a campaign against itself, timed in one half of the rounds and in the other.

``python -m tests.performance.repeats STORE`` prints the share of comparisons, one a problem, solver and error, that find no
difference, and exits with 1 where it is below 99 %.  What counts as level is measured on the other problems, so that no
comparison has a part in its own verdict.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from hhtbench.campaign.analysis import points
from hhtbench.campaign.analysis.cells import Point, by_entry
from hhtbench.campaign.analysis.fronts import cost_at, level_of, targets_of
from hhtbench.campaign.store import load_rows

ENOUGH = 0.99  # of the comparisons of a solver with itself that must find no difference


@dataclass(frozen=True, kw_only=True)
class Verdicts:
    """How many comparisons of a solver with itself there were, and which found a difference."""

    count: int
    levels: tuple[float, ...]  #: the factor that is level, of every problem
    differing: tuple[tuple[str, str, float, float], ...]  #: problem, entry, error, factor

    @property
    def share(self) -> float:
        """Of comparisons that find no difference."""
        return 1.0 - len(self.differing) / self.count if self.count else 0.0


def against_themselves(found: Sequence[Point]) -> Verdicts:
    """Of all runs that were timed more than once."""
    count, levels, differing = 0, [], []
    for problem in dict.fromkeys(run.problem for run in found):
        level = level_of(run for run in found if run.problem != problem)
        levels.append(level)
        groups = by_entry(run for run in found if run.problem == problem and len(run.repeats) > 1)
        for entry, runs in groups.items():
            halves = [[replace(run, time=min(run.repeats[part::2])) for run in runs] for part in (0, 1)]
            for target in targets_of(found):
                costs = [cost_at(half, target, "time") for half in halves]
                values = [cost.value for cost in costs if cost is not None]
                if len(values) == 2:
                    count += 1
                    factor = max(values) / min(values)
                    differing += [(problem, entry, target, factor)] if factor > level else []
    return Verdicts(count=count, levels=tuple(levels), differing=tuple(differing))


def main(store: str) -> int:
    """Print the share; 0 where it is large enough."""
    found = against_themselves(points(load_rows(Path(store))))
    for problem, entry, target, factor in found.differing:
        sys.stdout.write(f"{problem}  {entry}  error {target:.0e}: {factor:.2f}\n")
    spread = f"{min(found.levels):.3f} to {max(found.levels):.3f}" if found.levels else "not measured"
    said = f"{found.share:.2%} of {found.count} comparisons of a solver with itself find no difference"
    sys.stdout.write(f"{said}; level within a factor {spread}\n")
    return 0 if found.share >= ENOUGH else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
