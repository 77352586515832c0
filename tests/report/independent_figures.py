"""The figures of the first screen computed once more from the rows; the analysis is not imported."""

from __future__ import annotations

import math
from collections import defaultdict

from tests.report.independent import Truth, drifts, error, family, work

CLOSE = 0.01  # three digits are told


class Figures(Truth):
    """What the figures of the first screen may show of ``rows``."""

    def drift_points(self, measure):
        """Solver -> sorted (cost over HHT's, drift) at an error of 1e-4."""
        found = defaultdict(list)
        for problem, solvers in self.groups.items():
            if not self.constrained(problem) or self.limit(problem) > 1e-4:
                continue
            reached = {solver: self.reach(runs, 1e-4, measure) for solver, runs in solvers.items()}
            own = min((way[::2] for solver, way in reached.items() if way[0] and family(solver) == "hht"), default=(0, True))
            for solver, (cost, row, only_bound) in reached.items():
                if cost and not only_bound and not own[1] and drifts(row):
                    found[solver].append((cost / own[0], max(drifts(row))))
        return {solver: sorted(pairs) for solver, pairs in found.items()}

    def steps(self, measure, search):
        """Solver -> sorted (cost, weight) of the problem-error pairs that it reaches."""
        judged = {}
        for problem, solvers in self.groups.items():
            told = [row for runs in solvers.values() for row in runs if row.metrics.get("errors")]
            judged[problem] = [target for target in self.targets if told and target >= self.limit(problem)]
        judged = {problem: targets for problem, targets in judged.items() if targets}
        found = defaultdict(list)
        for problem, targets in judged.items():
            for solver, runs in self.groups[problem].items():
                runs = sorted(runs, key=lambda row: -row.request["rtol"])
                for target in targets:
                    cost = self.first(runs, target, measure, search)
                    if cost is not None:
                        found[solver].append((cost, 1 / len(judged) / len(targets)))
        known = {solver: [pair for pair in pairs if not math.isnan(pair[0])] for solver, pairs in found.items()}
        return {solver: sorted(pairs) for solver, pairs in known.items() if pairs}

    def first(self, runs, target, measure, search):
        spent = 0.0
        for row in runs:
            own = work(row, measure)
            if own and error(row) is not None and error(row) <= target:
                return spent + own if search else own
            if row.status != "declined":
                own = own or (row.request["max_seconds"] if measure == "time" else math.nan)
                spent += own
        return None


def false_drifts(view, rows, measure):
    """Solvers whose points in the figure of drift against cost are not those of the rows."""
    shown = defaultdict(list)
    for trace in view.figure["data"]:
        if trace["marker"]["size"] == 5:
            shown[trace["name"]] += zip(trace["x"], trace["y"], strict=True)
    return _different({name: sorted(pairs) for name, pairs in shown.items()}, Figures(rows).drift_points(measure))


def false_profiles(view, rows, measure):
    """Solvers whose curves are not those of the rows."""
    wrong = []
    for search in (False, True):
        shown = {}
        for trace in view.figure["data"]:
            if (trace["opacity"] < 1) == search and len(trace["x"]) > 1:
                shown[trace["name"]] = list(zip(trace["x"][1:-1], trace["y"][1:-1], strict=True))
        found = {}
        for name, pairs in Figures(rows).steps(measure, search).items():
            shares = [sum(weight for _, weight in pairs[: i + 1]) for i in range(len(pairs))]
            found[name] = [(cost, share) for (cost, _), share in zip(pairs, shares, strict=True)]
        wrong += _different(shown, found)
    return wrong


def _different(shown, found):
    wrong = sorted(set(shown) ^ set(found))
    for name in set(shown) & set(found):
        pairs = [(a, b) for one, two in zip(shown[name], found[name], strict=False) for a, b in zip(one, two, strict=True)]
        same = len(shown[name]) == len(found[name]) and all(abs(a - b) <= CLOSE * abs(b) for a, b in pairs)
        wrong += [] if same else [name]
    return wrong
