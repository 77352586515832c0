"""One solve of a case, whatever becomes of it."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

import hhtbench as hb
from hhtbench.protocol.events import Event
from solvers.hht import HHT
from tests.fuzz.cases import Case
from tests.fuzz.judge import Judge
from tests.fuzz.systems import Spoil, numpy_system, traced_system

SECONDS, EVALUATIONS = 60.0, 4_000  # of one solve; the second ends it on any machine
HOSTILE = 300  # evaluations of what need not arrive: each calls the functions 35 times, 105 without declared derivatives
RATE = 1.0  # [1/s] of a mechanism that has none, as it is not sound


def hht(system, span, q0, v0, options, events, request) -> hb.Solution:
    """What is fuzzed; tests put others in its place."""
    return HHT(system, events=events, **options).solve(span, q0, v0, **request)


class Found(NamedTuple):
    """What a solve has returned or raised."""

    solution: hb.Solution | None
    raised: BaseException | None
    seconds: float  #: of processor time

    @property
    def status(self) -> str:
        """Its label, or the class of what was raised."""
        return type(self.raised).__name__ if self.solution is None else self.solution.status.label


@dataclass(frozen=True)
class Setting:
    """A case with what follows from it: interval, start, system, request."""

    case: Case
    solver: object = hht
    given: float | None = None  #: [s] of the interval; None: as the way says

    @cached_property
    def judge(self) -> Judge:
        """Of the mechanism as it is solved."""
        return Judge(self.made)

    @cached_property
    def made(self):
        """The mechanism, with what a spoil makes of its numbers."""
        made, spoil = self.case.made, self.case.spoil
        if spoil is not None and spoil.kind == "units":
            return made.in_units(spoil.since, 1.0, 1.0)
        if spoil is not None and spoil.kind == "massless":
            return made.but(lambda name, x, _: x * (np.arange(x.size) > 0) if name == "mass" else x)
        return made

    @cached_property
    def rate(self) -> float:
        """[1/s] of what is fastest at the start."""
        with np.errstate(all="ignore"):
            try:
                found = self.judge.rate(self.judge.t0, *self.judge.start[:2])
            except np.linalg.LinAlgError:
                return RATE
        return found if np.isfinite(found) and found > 0.0 else RATE

    @cached_property
    def length(self) -> float:
        """[s] of the interval, signed."""
        if self.given is not None:
            return self.given
        return (-1.0 if self.case.way.backward else 1.0) * self.case.way.turns / self.rate

    @property
    def span(self) -> tuple[float, float]:
        """Start and end [s]."""
        return self.judge.t0, self.judge.t0 + self.length

    @property
    def start(self):
        """q0, v0 (n,), as they are given to the solver."""
        q, v, _ = self.judge.start
        spoil = self.case.spoil
        return (q * (1 + spoil.since) if spoil is not None and spoil.kind == "off" else q), v

    @property
    def request(self) -> dict:
        """Steps or tolerance, and budgets."""
        way = self.case.way
        most = HOSTILE if self.case.family == "hostile" else EVALUATIONS
        budget = {"max_seconds": SECONDS, "max_evaluations": most}
        if way.steps == 0:
            return {"rtol": way.rtol, **budget}
        if not way.ratios:
            return {"steps": way.steps, **budget}
        lengths = np.resize(way.ratios, way.steps)
        return {"steps": lengths * abs(self.length) / lengths.sum(), **budget}

    @cached_property
    def events(self) -> list:
        """What the way watches for: the first point's height halfway down what weights make of it."""
        kind, (q, _, _), i = self.case.way.watch, self.judge.start, self.made.shape.dim
        height = float(q[1]) - 0.01 * float(np.abs(q).max())
        turned = (lambda t, q, v: (q, -0.5 * v)) if kind == "change" else None
        fall = lambda t, q, v: q[1] - height  # noqa: E731
        return [Event(fall, terminal=kind == "terminal", change=turned, name="fall", samples=i)] if kind else []

    @cached_property
    def system(self):
        """Machine code for its family, functions in Python for the others."""
        return traced_system(self.made) if self.case.family == "machine" else self.callables

    @property
    def callables(self):
        """The functions in Python."""
        spoil = self.case.spoil
        if spoil is not None and spoil.kind in ("nan", "raise"):
            spoil = Spoil(spoil.kind, spoil.where, spoil.since * abs(self.length))
        return numpy_system(self.made, declares=self.case.way.declares, spoil=spoil)

    def run(self, *, system=None, options=(), span=None, start=None, events=None, **request) -> Found:
        """Solve, with parts of the setting changed."""
        given = {name: value for name, value in {**self.request, **request}.items() if value is not None}
        chosen, watched = {**self.case.way.options, **dict(options)}, self.events if events is None else events
        place = self.start if start is None else start
        began, solution, raised = time.process_time(), None, None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                solution = self.solver(system or self.system, span or self.span, *place, chosen, watched, given)
            except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001 - judged by what the case allows
                raised = error
        return Found(solution, raised, time.process_time() - began)

    @cached_property
    def base(self) -> Found:
        """The run as the case asks for it."""
        return self.run()

    @cached_property
    def must_succeed(self) -> bool:
        """Whether nothing excuses a failure: no fault, far from lost rank, a smooth reaction that leaves no row out."""
        case, way, shape, judge = self.case, self.case.way, self.made.shape, self.judge
        plain = case.family != "hostile" and way.watch != "change"  # changes may pile up
        doubled = len(judge.distinct) < len(shape.rods) + (shape.blade is not None)
        return plain and judge.sound and shape.reaction != "friction" and not (shape.reaction and doubled)
