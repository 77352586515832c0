"""The decision table computed once more from the rows, whole cells of it; nothing of the analysis is imported."""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from dataclasses import dataclass

from tests.report.independent import Truth, error, family, work

UNITS = {"s": 1.0, "ms": 1e-3, "\N{MICRO SIGN}s": 1e-6, "\N{MULTIPLICATION SIGN}": 1.0, "": 1.0}
CLOSE = 0.01  # three digits are told
NOTHING = "\N{EN DASH}"
LEVELS = ("position", "position and velocity", "velocity", "no")
ORDER = [
    f"{constraints}, {stiff}"
    for constraints in (*(f"{level} constraints" for level in LEVELS), "constraints not recorded")
    for stiff in ("not tagged stiff", "tagged stiff", "stiffness not recorded")
]


def short(name):
    return re.sub("(method|form|solver)=|alpha=(?=-)", "", name)


def kind(rows):
    """In words, by the sizes and tags that any of the rows tell."""
    told = [row.metrics["system"] for row in rows if row.metrics.get("system")]
    sizes = {(one["m"], one["p"]) for one in told if one["m"] is not None}
    constraints = "constraints not recorded"
    if sizes:
        ((m, p),) = sizes
        constraints = (" and ".join(["position"] * bool(m) + ["velocity"] * bool(p)) or "no") + " constraints"
    stiff = "not " * all("stiff" not in one["tags"] for one in told) + "tagged stiff"
    return f"{constraints}, {stiff if told else 'stiffness not recorded'}"


@dataclass
class Standing:
    """One solver on the problems of a line."""

    solver: str
    costs: dict  #: problem -> cost of those that it reaches, and whether that is an upper bound
    missed: list  #: what counts for those that it does not reach
    unknown: list  #: why it is not known of the others

    @property
    def mean(self):
        counted = [cost for cost, _ in self.costs.values()] + self.missed
        return math.prod(counted) ** (1 / len(counted)) if counted else math.inf

    @property
    def bounds(self):
        """Whether the mean is an upper, a lower bound."""
        return any(bound for _, bound in self.costs.values()), bool(self.missed)

    def on(self, problems):
        return Standing(self.solver, {problem: self.costs[problem] for problem in problems}, [], [])

    @property
    def reach(self):
        total = len(self.costs) + len(self.missed) + len(self.unknown)
        known = total - len(self.unknown)
        parts = [f"reaches {len(self.costs)} of {total}"] * (known > 0 and len(self.costs) < total)
        for reason, count in Counter(self.unknown).items():
            parts.append(reason if count == total else f"{reason} on {count}")
        return parts


def sign(upper, lower):
    return "about " if upper and lower else "at most " if upper else "at least " if lower else ""


class Lines(Truth):
    """What the lines of the table may say of ``rows``; ``pace`` evaluations count for a second."""

    def __init__(self, rows, pace):
        super().__init__(rows)
        self.pace = pace

    def kinds(self):
        found = defaultdict(list)
        for problem, solvers in self.groups.items():
            found[kind([row for runs in solvers.values() for row in runs])].append(problem)
        return sorted(found.items(), key=lambda item: ORDER.index(item[0]))

    def judged(self, problems, target, bound):
        """Where an error can be told, one as small as ``target``, and with a bound the drift."""
        kept = []
        for problem in problems:
            ends = [row for runs in self.groups[problem].values() for row in runs if row.success]
            told = target >= self.limit(problem) and all("errors" in row.metrics for row in ends)
            kept += [problem] * (told and (bound is None or self.constrained(problem)))
        return kept

    def standings(self, problems, target, measure, bound):
        """Who reaches the most first, of these the cheapest, then who comes first in the rows."""
        solvers = list(dict.fromkeys(solver for problem in problems for solver in self.groups[problem]))
        found = [self.standing(solver, problems, target, measure, bound) for solver in solvers]
        return sorted(found, key=lambda one: (-len(one.costs), float(f"{one.mean:.9e}")))

    def standing(self, solver, problems, target, measure, bound):
        found = Standing(solver, {}, [], [])
        for problem in problems:
            runs = sorted(self.groups[problem].get(solver, []), key=lambda row: -row.request["rtol"])
            cost, _, upper = self.reach(runs, target, measure, bound)
            accurate = any(error(row) is not None and error(row) <= target and work(row, measure) for row in runs)
            reason = "" if accurate and bound is not None else self.untold(runs, measure)
            if cost is not None:
                found.costs[problem] = cost, upper
            elif reason:
                found.unknown.append(reason)
            else:
                found.missed.append(self.allowed(runs, measure))
        return found

    def untold(self, runs, measure):
        """Why it is not known whether these runs' solver can reach what they do not reach; "" where it is."""
        if not runs:
            return "not run"
        known = [row for row in runs if error(row) is not None]
        if known and not any(work(row, measure) for row in known):
            return "not reported"
        rules = runs[0].request.get("rules")
        if rules is None:
            return "no run so accurate" if runs[-1].success else ""
        return "stopped" if len(runs) < rules["refinements"] and all(row.success for row in runs) else ""

    def allowed(self, runs, measure):
        """What these runs were allowed; what the finest took, where that is more."""
        rules = [row.request.get("rules") or {} for row in runs]
        seconds = max([row.request["max_seconds"] for row in runs] + [one.get("pair_seconds", 0.0) for one in rules])
        spent = [work(row, measure) or (measure == "time" and self.late(row)) for row in runs]
        finest = [value for value in spent if value][-1:]
        return max([seconds * (1.0 if measure == "time" else self.pace), *finest])

    @staticmethod
    def late(row):
        """What a run that was ended has taken."""
        return row.request["max_seconds"] if row.status == "deadline" else None

    def cells(self, name, problems, target, measure, bound):
        """One line: of each cell what comes before its number, the number or None, what comes after, and its tone."""
        found = self.standings(problems, target, measure, bound)
        ranked = [one for one in found if one.costs and not one.unknown]
        others = [one for one in found if one not in ranked]
        head = f"{name} | {len(problems)} problem{'s' * (len(problems) > 1)}"
        line = [(head, None, "", ""), (f"{target:.0e} | ", None, "", "")]
        if not ranked:
            whole = [one for one in others if not one.unknown]
            nobody = "nobody" + " known on all" * (len(whole) < len(others)) + " gets there" * bool(whole)
            head = [*line, (f"{nobody} | ", None, "", ""), *self.absent()]
            return [*head, self.hht(ranked, others, measure, None), *self.absent()]
        first = ranked[0]
        line.append((f"{short(first.solver)} | {sign(*first.bounds)}", first.mean, _tail(first.reach), ""))
        line += [self.dearer(ranked[1], ranked[1], first, measure)] if len(ranked) > 1 else self.absent()
        cheaper = self.cheaper(found, first, measure)
        return [*line, self.hht(ranked, others, measure, cheaper), cheaper]

    @staticmethod
    def absent():
        return [(f"{NOTHING} | ", None, "", "")]

    def dearer(self, one, own, its, measure, place="", last=(), tone=""):
        """A cell with how many times dearer it is, by ``own`` and ``its`` problems."""
        ratio = own.mean / its.mean
        upper, lower = own.bounds[0] or its.bounds[1], own.bounds[1] or its.bounds[0]
        most = self.level if measure == "time" else 1.0
        close = ["level"] * (not upper and not lower and 1 / most <= ratio <= most)
        return f"{place or short(one.solver)} | {sign(upper, lower)}", ratio, _tail([*close, *one.reach, *last]), tone

    def hht(self, ranked, others, measure, cheaper):
        own = [one for one in ranked if family(one.solver) == "hht"]
        if own:
            number = ranked.index(own[0]) + 1
            place = f"{number} of {len(ranked)}"
            if number == 1:
                tone = "" if own[0].missed or [cheaper] != self.absent() else "good"
                return f"{place} | {short(own[0].solver)}", None, "", tone
            return self.dearer(own[0], own[0], ranked[0], measure, place, [short(own[0].solver)])
        own = [one for one in others if family(one.solver) == "hht"]
        if own and not any(one.costs or one.unknown for one in own):
            return "does not get there | ", None, "", "bad"
        best = min(own, key=lambda one: (-len(one.costs), len(one.missed)), default=None)
        return f"{'not run' if best is None else ', '.join(best.reach)} | ", None, "", ""

    def cheaper(self, found, first, measure):
        """Who costs the least beside the first where both get there, if that is less by more than repeats differ."""
        most, best = self.level if measure == "time" else 1.0, None
        for one in found:
            both = [problem for problem in one.costs if problem in first.costs]
            own, its = one.on(both), first.on(both)
            if both and own.mean * most < its.mean and (best is None or own.mean / its.mean < best[1].mean / best[2].mean):
                best = one, own, its
        return self.absent()[0] if best is None else self.dearer(*best, measure)


def _tail(parts):
    return "".join(f", {part}" for part in parts)


def _agree(told, tone, head, value, tail, right_tone):
    """Whether a whole cell is right: words and tone to the letter, the number to its digits."""
    if value is None:
        return (told, tone) == (head + tail, right_tone)
    inside = re.fullmatch(rf"{re.escape(head)}(\d[\d.,]*(?:e[+-]?\d+)?) ?(\D*?){re.escape(tail)}", told)
    if inside is None or inside[2] not in UNITS or tone != right_tone:
        return False
    return math.isclose(
        float(inside[1].replace(",", "")) * UNITS[inside[2]], value, rel_tol=CLOSE, abs_tol=0.5 * (inside[2] == "")
    )


def false_lines(tables, rows, pace):
    """What of the decision tables the rows do not bear out."""
    truth, wrong = Lines(rows, pace), []
    for (measure, bound), table in tables.items():
        told = iter(table.rows)
        for name, members in truth.kinds():
            for target in (1e-2, 1e-4, 1e-6):
                problems = truth.judged(members, target, bound)
                if problems:
                    line = truth.cells(name, problems, target, measure, bound)
                    wrong += [f"{measure}, {bound}: {text}" for text in _false(next(told, ()), line)]
        wrong += [f"{measure}, {bound}: a line too many" for _ in told]
    return wrong


def _false(told, line):
    texts = [(f"{cell.text} | {cell.detail}", cell.tone) for cell in told]
    texts += [(f"{NOTHING} | ", "")] * (len(texts) == len(line) - 1)  # a column of which no line says anything is left out
    if len(texts) != len(line):
        return [f"{len(texts)} cells instead of {len(line)}: {line[0][0]}"]
    return [f"told {text}, found {found}" for text, found in zip(texts, line, strict=True) if not _agree(*text, *found)]
