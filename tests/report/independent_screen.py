"""The decision table and the figures of the first screen computed once more from the rows; the analysis is not imported."""

from __future__ import annotations

import math
import re
from collections import defaultdict

from tests.report.independent import Truth, drifts, error, family, work

PACE = {"time": 1.0, "evaluations": 1e6}  # what counts for each second that was allowed, where an error is not reached
UNITS = {"s": 1.0, "ms": 1e-3, "\N{MICRO SIGN}s": 1e-6, "": 1.0}
CLOSE = 0.01  # three digits are told


def short(name):
    return re.sub("(method|form|solver)=|alpha=(?=-)", "", name)


def kind(rows):
    """In words, by the sizes and tags that a row tells."""
    known = [row.metrics["system"] for row in rows if row.metrics.get("system")]
    if not known:
        return "constraints not recorded, stiffness not declared"
    m, p, tags = (known[0][name] for name in ("m", "p", "tags"))
    levels = " and ".join(["position"] * bool(m) + ["velocity"] * bool(p)) or "no"
    return f"{levels} constraints, {'stiff' if 'stiff' in tags else 'not stiff' if tags else 'stiffness not declared'}"


class Screen(Truth):
    """What the first screen may show of ``rows``."""

    def kinds(self):
        found = defaultdict(list)
        for problem, solvers in self.groups.items():
            found[kind([row for runs in solvers.values() for row in runs])].append(problem)
        return found

    def knows(self, problem, target):
        """Whether an error can be told on this problem, and one as small as ``target``."""
        ends = [row for runs in self.groups[problem].values() for row in runs if row.success]
        return target >= self.limit(problem) and all("errors" in row.metrics for row in ends)

    def counted(self, solver, problem, target, measure, bound):
        """(what counts as the solver's cost, whether it is one); None where it is not known."""
        runs = self.groups[problem].get(solver)
        if not runs:
            return None
        cost = self.cost(runs, target, measure, bound)
        if cost is not None:
            return cost, True
        if any(error(row) is not None for row in runs) and not any(work(row, measure) for row in runs if error(row)):
            return None  # not reported
        seconds = max(((row.request.get("rules") or {}).get("pair_seconds", 0.0) for row in self.rows), default=0.0) or 60.0
        return seconds * PACE[measure], False

    def line(self, problems, target, measure, bound):
        """(solver, geometric mean, problems reached) of who was run on all, the cheapest first."""
        found = []
        for solver in {solver for problem in problems for solver in self.groups[problem]}:
            counted = [self.counted(solver, problem, target, measure, bound) for problem in problems]
            if None not in counted and any(reached for _, reached in counted):
                mean = math.exp(sum(math.log(cost) for cost, _ in counted) / len(counted))
                found.append((mean, solver, sum(reached for _, reached in counted)))
        return sorted(found)

    def hht(self, problems, target, measure, bound):
        """Why HHT has no place: not run, unknown, run on a part only, or it does not get there."""
        own = {solver for problem in problems for solver in self.groups[problem] if family(solver) == "hht"}
        counted = {s: [self.counted(s, problem, target, measure, bound) for problem in problems] for s in own}
        known = {s: [pair for pair in pairs if pair is not None] for s, pairs in counted.items()}
        there = [len(pairs) for pairs in known.values() if any(reached for _, reached in pairs)]
        if there:
            return f"run on {max(there)} of {len(problems)}"
        return "not run" if not own else "does not get there" if any(known.values()) else "unknown"

    def nobody(self, problems, target, measure, bound):
        """Why there is no cheapest."""
        solvers = {solver for problem in problems for solver in self.groups[problem]}
        counted = [[self.counted(s, problem, target, measure, bound) for problem in problems] for s in solvers]
        known = [[pair for pair in pairs if pair is not None] for pairs in counted]
        if any(reached for pairs in known for _, reached in pairs):
            return (
                "nobody who was run on all gets there"
                if any(None not in pairs for pairs in counted)
                else "nobody run on all"
            )
        return "nobody gets there" if any(known) else "unknown"

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


def number(text):
    """The first number of a cell's detail, with its unit."""
    found = re.search(r"(\d[\d.]*(?:e[-+]?\d+)?)\s?(ms|s|\N{MICRO SIGN}s)?", text)
    return float(found[1]) * UNITS[found[2] or ""]


def false_lines(tables, rows):
    """What of the decision tables the rows do not bear out."""
    truth, wrong = Screen(rows), []
    for (measure, bound), table in tables.items():
        lines = iter(table.rows)
        for name, members in sorted(truth.kinds().items(), key=lambda item: ORDER.index(item[0])):
            for target in (1e-2, 1e-4, 1e-6):
                problems = [problem for problem in members if truth.knows(problem, target)]
                if problems and not (bound and name.startswith("no ")):
                    told = [f"{cell.text} | {cell.detail}" for cell in next(lines, [])]
                    found = (truth, problems, target, measure, bound)
                    wrong += [
                        f"{name}, {target:.0e}, {measure}, {bound}: {told}: {why}" for why in _false(told, name, *found)
                    ]
        wrong += [f"{measure}, {bound}: a line too many" for _ in lines]
    return wrong


ORDER = [
    f"{levels} constraints, {stiff}"
    for levels in ("position", "position and velocity", "velocity", "no")
    for stiff in ("not stiff", "stiff", "stiffness not declared")
] + ["constraints not recorded, stiffness not declared"]


def _false(told, name, truth, problems, target, measure, bound):
    if not told:
        return ["there is no such line"]
    ranked = truth.line(problems, target, measure, bound)
    wrong = [] if told[1].startswith(f"{target:.0e}") else ["another error"]
    wrong += [] if told[0].startswith(f"{name} | {len(problems)} problem") else [f"of {len(problems)} problems"]
    for place, (column, of) in enumerate(((2, 1.0), (3, ranked[0][0] if ranked else 1.0))):
        if len(ranked) > place:
            mean, solver, reached = ranked[place]
            shown, _, detail = told[column].partition(" | ")
            right = shown == short(solver) and abs(number(detail) / (mean / of) - 1) < CLOSE
            counted = reached == len(problems) or f"reaches {reached} of {len(problems)}" in told[column]
            wrong += [] if right and counted else [f"{solver}, {mean:.3g}, {mean / of:.3g} times, reaches {reached}"]
    if not ranked and told[2].partition(" | ")[0] != (why := truth.nobody(problems, target, measure, bound)):
        wrong.append(why)
    own = next((place for place, (_, solver, _) in enumerate(ranked, 1) if family(solver) == "hht"), None)
    place = f"{own} of {len(ranked)}" if own else truth.hht(problems, target, measure, bound)
    return wrong + ([] if told[4].startswith(place) else [f"HHT: {place}"])


def false_drifts(view, rows, measure):
    """Solvers whose points in the figure of drift against cost are not those of the rows."""
    shown = defaultdict(list)
    for trace in view.figure["data"]:
        if trace["marker"]["size"] == 5:
            shown[trace["name"]] += zip(trace["x"], trace["y"], strict=True)
    return _different({name: sorted(pairs) for name, pairs in shown.items()}, Screen(rows).drift_points(measure))


def false_profiles(view, rows, measure):
    """Solvers whose curves are not those of the rows."""
    wrong = []
    for search in (False, True):
        shown = {}
        for trace in view.figure["data"]:
            if (trace["opacity"] < 1) == search and len(trace["x"]) > 1:
                shown[trace["name"]] = list(zip(trace["x"][1:-1], trace["y"][1:-1], strict=True))
        found = {}
        for name, pairs in Screen(rows).steps(measure, search).items():
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
