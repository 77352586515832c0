"""The summary's sentences computed once more from the rows, by other means than the analysis; nothing of it is imported.

So is the order of solvers in the table to decide by.
"""

from __future__ import annotations

import math
import re
import statistics
from collections import Counter, defaultdict

TARGETS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
BOUNDS = {"Whatever the drift": None, "With drift of at most 1e-06": 1e-6, "With drift of at most 1e-10": 1e-10}


def family(solver):
    """HHT in minimal coordinates is HHT."""
    inside = re.search(r"solver='?(\w+)", solver) if solver.startswith("minimal") else None
    return inside[1] if inside else solver.partition("(")[0]


def name(row):
    plain = row.solver.replace("'", "")
    return plain if row.request.get("rtol") is not None else f"{plain}, steps=N"


def error(row):
    if row.status not in ("success", "event") or "errors" not in row.metrics:
        return None
    return max(row.metrics["errors"][key]["max_scaled"] for key in ("q", "v"))


def work(row, measure):
    """Processor time alone on a core; where there is none, beside other work."""
    if measure != "time":
        count, call = row.counters.get("residual_evaluations"), row.metrics.get("call")
        return count * call["operations"] / call["of_residual"] if count and call else count
    return row.timing.get("best_s") or row.timing.get("solve_cpu_s") or row.timing.get("solve_s")


def drifts(row):
    found = row.metrics.get("drift") or {}
    return [found[level] for level in ("position", "velocity") if found.get(level) is not None]


class Truth:
    """What the sentences may say of ``rows``."""

    def __init__(self, rows):
        self.rows = rows
        self.groups = defaultdict(lambda: defaultdict(list))
        for row in rows:
            self.groups[row.problem][name(row)].append(row)
        asked = {a for row in rows for a in (row.request.get("rules") or {}).get("accuracies", ())}
        self.targets = sorted(asked, reverse=True) or TARGETS
        self.levels = {p: max(len(drifts(row)) for runs in g.values() for row in runs) for p, g in self.groups.items()}
        ratios = []
        for row in rows:
            times = row.timing.get("rounds_s") or []
            ratios += [max(a, b) / min(a, b) for i, a in enumerate(times) for b in times[:i]]
        self.level = sorted(ratios)[math.ceil(0.995 * len(ratios)) - 1] if ratios else 1.0

    def limit(self, problem):
        rows = [row for runs in self.groups[problem].values() for row in runs]
        digits = [row.metrics["errors"].get("digits") for row in rows if "errors" in row.metrics]
        return max((10.0**-d for d in digits if d is not None), default=0.0)

    def constrained(self, problem):
        return self.levels[problem] > 0

    def cost(self, runs, target, measure, bound=None):
        return self.reach(runs, target, measure, bound)[0]

    def reach(self, runs, target, measure, bound=None):
        """The cheapest run that is accurate enough, moved along the line to the best of the cheaper ones.

        Cost, this run, and whether there is no cheaper one and it is more accurate than asked.
        """
        known = [(work(row, measure), error(row), row) for row in runs if bound is None or self.steady(row, bound)]
        known = [run for run in known if run[0] and run[1] is not None]
        there = [run for run in known if run[1] <= target]
        if not there:
            return None, None, False
        fine = min(there, key=lambda run: run[:2])
        cheaper = [run for run in known if run[0] < fine[0]]
        if not cheaper:
            return fine[0], fine[2], fine[1] < target
        coarse = min(cheaper, key=lambda run: (run[1], run[0]))
        share = (math.log(coarse[1]) - math.log(target)) / (math.log(coarse[1]) - math.log(fine[1]))
        return math.exp((1 - share) * math.log(coarse[0]) + share * math.log(fine[0])), fine[2], False

    def steady(self, row, bound):
        return len(drifts(row)) == self.levels[row.problem] and all(value <= bound for value in drifts(row))

    def sides(self, problem, target, measure, bound):
        """The best of HHT and of the others; None where nobody gets there."""
        best = {}
        for solver, runs in self.groups[problem].items():
            found = self.cost(runs, target, measure, bound) if target >= self.limit(problem) else None
            side = family(solver) == "hht"
            if found is not None and found < best.get(side, math.inf):
                best[side] = found
        return best.get(True), best.get(False)

    def tally(self, measure, bound, problems=None):
        """Wins, losses, level ones and how many in all."""
        counts = Counter()
        level = self.level if measure == "time" else 1.0
        for problem in self.groups if problems is None else problems:
            if bound is not None and not self.constrained(problem):
                continue
            for target in self.targets:
                mine, other = self.sides(problem, target, measure, bound)
                if mine and other:
                    counts["all"] += 1
                    close = max(mine, other) / min(mine, other) <= level * (1 + 1e-12)
                    counts["level" if close else "wins" if mine < other else "loses"] += 1
        return counts["wins"], counts["loses"], counts["level"], counts["all"]

    def reached(self):
        """Targets in all, and reached by processor time."""
        total = found = 0
        for problem, solvers in self.groups.items():
            for runs in solvers.values():
                for target in self.targets:
                    total += 1
                    cost = self.cost(runs, target, "time") if target >= self.limit(problem) else None
                    found += cost is not None
        return total, found

    def accurate(self, problem, solver):
        """The run nearest to 1e-4, where that is within a factor of ten."""
        found = [row for row in self.groups[problem].get(solver, ()) if error(row)]
        found = sorted(found, key=lambda row: abs(math.log10(error(row) * 1e4)))
        return found[0] if found and 1e-5 <= error(found[0]) <= 1e-3 else None

    def steadies(self, level):
        """HHT's largest drift of the level, how many others stay below 1e-10, of how many, and the largest."""
        found = defaultdict(list)
        for problem, solvers in self.groups.items():
            for solver in solvers:
                row = self.accurate(problem, solver)
                value = None if row is None else (row.metrics.get("drift") or {}).get(level)
                if value is not None:
                    found[solver].append(value)
        own = [value for solver, values in found.items() if family(solver) == "hht" for value in values]
        others = {solver: values for solver, values in found.items() if family(solver) != "hht"}
        held = sum(max(values) <= 1e-10 for values in others.values())
        largest = max((max(values) for values in others.values()), default=None)
        return max(own, default=None), (held, len(others)), largest

    def order(self, problems, target, measure, bound):
        """Who reaches the most of ``problems`` first, of these the cheapest: solver, number, geometric mean of the costs."""
        problems = [p for p in problems if target >= self.limit(p) and (bound is None or self.constrained(p))]
        judged = [p for p in problems if all("errors" in r.metrics for g in self.groups[p].values() for r in g if r.success)]
        found = []
        for solver in dict.fromkeys(solver for problem in judged for solver in self.groups[problem]):
            costs = [self.cost(self.groups[p].get(solver, ()), target, measure, bound) for p in judged]
            costs = [cost for cost in costs if cost is not None]
            found.append((solver, len(costs), statistics.geometric_mean(costs) if costs else math.inf))
        return sorted(found, key=lambda one: (-one[1], float(f"{one[2]:.9e}")))


TALLY = r"wins (\d+), loses (\d+) and is equal in (\d+) of (\d+) comparisons?"


def false_sentences(text, rows):
    """Every number of the summary that the rows do not bear out; empty where all is true."""
    truth, wrong = Truth(rows), []

    def expect(what, told, found):
        if told != found:
            wrong.append(f"{what}: told {told}, found {found}")

    good = sum(row.status in ("success", "event") for row in rows)
    head = re.search(r"(\d+) of (\d+) runs? reached the end with a sound result \((\d+) problems?, (\d+) solvers?\)", text)
    solvers = {solver for group in truth.groups.values() for solver in group}
    expect("coverage", tuple(map(int, head.groups())), (good, len(rows), len(truth.groups), len(solvers)))
    asked = re.search(r"Of (\d+) goals?, .*?, (\d+) (?:is|are) reached\.(.*?)Not tried: (\d+)", text)
    expect("targets", (int(asked[1]), int(asked[2])), truth.reached())
    others = sum(map(int, re.findall(r"[a-z] (\d+)[,.]", asked[3])))
    expect("targets that are not reached", others, int(asked[1]) - int(asked[2]))
    for words, measure in (("processor time", "time"), ("residual evaluations", "evaluations")):
        part = re.search(rf"By {words}, HHT's best entry(.*?)(?=By |On the|At equal accuracy|$)", text)
        for sentence, bound in BOUNDS.items():
            told = part and re.search(rf"{sentence}[^.]*?, HHT {TALLY}", part[1], re.IGNORECASE)
            found = truth.tally(measure, bound)
            if told or found[3]:
                expect(f"{words}, {sentence}", told and tuple(map(int, told.groups())), found)
    held_out = {row.problem for row in rows if row.request.get("held_out")}
    told = re.search(rf"On the (\d+) problems? that (?:was|were) held out, by processor time, HHT {TALLY}", text)
    if told:
        expect("held out", tuple(map(int, told.groups())), (len(held_out), *truth.tally("time", None, held_out)))
    for level in ("position", "velocity"):
        own, held, largest = truth.steadies(level)
        part = re.search(rf"HHT's largest {level} drift is ([\d.e+-]+) (.*?)\.(?: |$)", text)
        if part:
            expect(f"HHT's {level} drift", part[1], f"{own:.3g}")
            counted = re.search(r"(\d+) of (\d+) others? stay at or below 1e-10", part[2])
            expect(f"steady at {level}", tuple(map(int, counted.groups())) if counted else (0, 0), held)
            most = re.search(r"the largest is ([\d.e+-]+)", part[2])
            expect(f"largest {level} drift", most and most[1], None if largest is None else f"{largest:.3g}")
    return wrong
