"""The decision table computed once more from the rows, whole cells of it; nothing of the analysis is imported."""

from __future__ import annotations

import math
import re
import statistics
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


UNKNOWN = ("not run", "not reported", "no run so accurate", "stopped")


@dataclass
class Standing:
    """One solver on the problems of a line."""

    solver: str
    costs: dict  #: problem -> cost of those that it reaches, and whether that is an upper bound
    why: list  #: why it does not reach the others

    @property
    def mean(self):
        return _mean(cost for cost, _ in self.costs.values()) if self.costs else math.inf

    @property
    def failed(self):
        return sum(reason not in UNKNOWN for reason in self.why)

    @property
    def reasons(self):
        total = len(self.costs) + len(self.why)
        return [reason + f" on {count}" * (count < total) for reason, count in Counter(self.why).most_common()]

    @property
    def reach(self):
        total = len(self.costs) + len(self.why)
        return [f"reaches {len(self.costs)} of {total}", *self.reasons] if self.why else []


def _mean(values):
    return statistics.geometric_mean(values)


def sign(upper, lower):
    return "about " if upper and lower else "at most " if upper else "at least " if lower else ""


class Lines(Truth):
    """What the lines of the table may say of ``rows``."""

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
        found = Standing(solver, {}, [])
        for problem in problems:
            runs = sorted(self.groups[problem].get(solver, []), key=lambda row: -row.request["rtol"])
            cost, _, upper = self.reach(runs, target, measure, bound)
            accurate = any(error(row) is not None and error(row) <= target and work(row, measure) for row in runs)
            if cost is not None:
                found.costs[problem] = cost, upper
            elif accurate and bound is not None:
                found.why.append("more drift")
            else:
                found.why.append(self.untold(runs, measure) or self.ended(runs))
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

    @staticmethod
    def ended(runs):
        """How a solver's runs ended that do not get there."""
        best, idle, late = math.inf, 0, 0  # the smallest error, runs without a smaller one, and failures, since then
        for row in runs:
            late = 0 if row.success else late + 1
            if row.success and error(row) is not None:
                idle = 0 if error(row) < 0.9 * best else idle + 1
                best = min(best, error(row))
        if {row.status for row in runs} == {"declined"}:
            return "refused"
        if late and (late > 1 or "rules" not in runs[-1].request):
            return "failed"
        return "no better when finer" if idle >= 3 else "a stated cap"

    def cells(self, name, problems, target, measure, bound):
        """One line: of each cell what comes before its number, the number or None, what comes after, and its tone."""
        found = self.standings(problems, target, measure, bound)
        ranked = [one for one in found if one.costs]
        head = f"{name} | {len(problems)} problem{'s' * (len(problems) > 1)}"
        line = [(head, None, "", ""), (f"{target:.0e} | ", None, "", "")]
        if not ranked:
            known = not any(reason in UNKNOWN for one in found for reason in one.why)
            nobody = "nobody gets there" + ", as far as is known" * (not known)
            return [*line, (f"{nobody} | ", None, "", ""), *self.absent(), self.hht(ranked, found, measure), *self.absent()]
        first = ranked[0]
        upper = any(bound for _, bound in first.costs.values())
        line.append((f"{short(first.solver)} | {sign(upper, False)}", first.mean, _tail(first.reach), ""))
        line += [self.dearer(ranked[1], first, measure)] if len(ranked) > 1 else self.absent()
        return [*line, self.hht(ranked, found, measure), self.cheaper(ranked, first, measure)]

    @staticmethod
    def absent():
        return [(f"{NOTHING} | ", None, "", "")]

    @staticmethod
    def ratio(one, first):
        """Its cost over the first's where both get there, on how many, and whether one above or below is a bound."""
        both = [problem for problem in one.costs if problem in first.costs]
        if not both:
            return None, 0, False, False
        value = _mean(one.costs[problem][0] / first.costs[problem][0] for problem in both)
        return value, len(both), *(any(side.costs[problem][1] for problem in both) for side in (one, first))

    def same(self, ratio, measure):
        most = self.level if measure == "time" else 1.0
        return ratio is not None and 1 / most <= ratio <= most

    def level_with(self, one, first, measure):
        ratio, _, upper, lower = self.ratio(one, first)
        return self.same(ratio, measure) and not (upper or lower)

    def dearer(self, one, first, measure, place="", last=()):
        """A cell with how many times dearer it is."""
        ratio, common, upper, lower = self.ratio(one, first)
        head = f"{place or short(one.solver)} | "
        if ratio is None:
            return head + ", ".join(["on other problems", *one.reach, *last]), None, "", ""
        tail = f" on {common}" * (common < len(first.costs)) + ", level" * self.level_with(one, first, measure)
        return head + sign(upper, lower), ratio, tail + _tail([*one.reach, *last]), ""

    def hht(self, ranked, found, measure):
        own = [one for one in found if family(one.solver) == "hht"]
        if not own:
            return "not run | ", None, "", ""
        best = min(own, key=lambda one: (-len(one.costs), one.failed))
        if not best.costs:
            why = ", ".join(best.reasons)
            return (f"does not get there | {why}", None, "", "bad") if best.failed else (f"{why} | ", None, "", "")
        place = f"{ranked.index(best) + 1} of {len(ranked)}"
        if best is not ranked[0]:
            return self.dearer(best, ranked[0], measure, place, [short(best.solver)])
        others = [self.ratio(one, best) for one in ranked[1:]]
        near = [ratio for ratio, *_ in others if ratio is not None and ratio <= (self.level if measure == "time" else 1.0)]
        shared = bool(others) and self.level_with(ranked[1], best, measure)
        text = ", ".join([*["level"] * shared, *best.reach, short(best.solver)])
        return f"{place} | {text}", None, "", "" if best.why or near or (others and others[0][2]) else "good"

    def cheaper(self, ranked, first, measure):
        """Who costs the least beside the first where both get there, if that is less by more than repeats differ."""
        most, found = self.level if measure == "time" else 1.0, []
        for one in ranked:
            ratio, _, _, lower = self.ratio(one, first)
            if one is not first and ratio is not None and not lower and ratio * most < 1:
                found.append((ratio, one))
        return self.dearer(min(found, key=lambda pair: pair[0])[1], first, measure) if found else self.absent()[0]


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


def false_lines(tables, rows):
    """What of the decision tables the rows do not bear out."""
    truth, wrong = Lines(rows), []
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
