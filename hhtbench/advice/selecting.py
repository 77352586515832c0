"""``hhtbench.select``: recommend a solver for one error on one problem, from the best evidence available."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from hhtbench.advice.criteria import Criteria
from hhtbench.advice.database import ACCURACIES, HELD, Database, foreign, read_database, versions_of
from hhtbench.advice.features import probe
from hhtbench.advice.nearest import Expectation, Space, error_of, expected, key_of
from hhtbench.advice.standing import CostsSoFar
from hhtbench.advice.trading import trade
from hhtbench.advice.verdict import as_run, ranking, sentence
from hhtbench.campaign.analysis import newest
from hhtbench.campaign.analysis.cells import asked_of, kind_of, spec_of
from hhtbench.campaign.analysis.fronts import Front
from hhtbench.campaign.analysis.missing import UNKNOWN
from hhtbench.campaign.machine import clock_of
from hhtbench.campaign.plan import outdated
from hhtbench.campaign.store import RunRow, load_rows
from hhtbench.catalogue.registry import load_problem
from hhtbench.catalogue.specs import canonical
from hhtbench.protocol.arguments import real_number
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.printing import Printed
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import NumpySystem

TIGHTEST = HELD[1]  # bound of the drift that a database knows
ERRORS = f"{max(ACCURACIES):g} to {min(ACCURACIES):g}"


@dataclass(frozen=True, kw_only=True)
class Advice(Printed):
    """Recommendation of :func:`select` with its evidence."""

    problem: str
    taken: str | None  #: the solver with its options, as ``hb.solve`` takes it; None: no solver can be named
    taken_by: str | None  #: argument of ``hb.solve`` that controls the error: "rtol", or "steps" for constant steps
    second: str | None
    second_by: str | None
    on: str  #: what was compared: "time" or "evaluations"
    text: str  #: the solver to take and its cost, or why none can be named and what to do
    evidence: str  #: runs or known problems behind it
    domain: str  #: where that holds
    reason: str  #: in one line

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return asdict(self)

    def __repr__(self) -> str:
        return f"<Advice on {self.problem}: {self.text}>"

    def __str__(self) -> str:
        lines = [("evidence", self.evidence), ("domain", self.domain), ("reason", self.reason)]
        return "\n".join([self.text, *(f"  {name}: {value}" for name, value in lines if value)])


def select(
    problem: str | Problem,
    *,
    accuracy: float = 1e-4,
    drift: float | None = None,
    on: str = "time",
    seconds: float = 0.0,
    store: str | Path | None = None,
    database: str | Path | None = None,
) -> Advice:
    """Recommend the solver that reaches an error most cheaply.

    The evidence is rows of the problem in ``store`` if there are some; else a :func:`trade` of ``seconds``; else the
    problem's features and a database of other problems.

    Parameters
    ----------
    problem
        A spec; a Problem only without ``store`` and ``seconds``.
    accuracy
        Error of q and v, scaled by the problem's scales.
    drift
        Largest scaled drift of position and velocity constraints; None: any.
    on
        What to minimise: "time" or "evaluations".  Times of another machine, or of other versions, are refused;
        evaluations are then used instead, and the text says so.
    seconds
        Time for measuring [s]; 0: nothing is run.
    store
        SQLite file of ``run`` or ``trade``.
    database
        Made by ``hhtbench study selection``; None: that of the package.

    Raises
    ------
    NotFoundError, ProblemError, TypeError
        Wrong use.
    """
    criteria = Criteria(accuracies=(accuracy,), on=on, drift=drift)
    if real_number("seconds", seconds) < 0.0:
        raise ProblemError(f"seconds must not be negative; got {seconds:g}.")
    if not isinstance(problem, str) and (store is not None or seconds > 0.0):
        raise TypeError("rows and runs belong to a spec, as text; give one, or leave store and seconds out.")
    loaded, known, found = load_problem(problem), None, None
    if store is not None and (seconds == 0.0 or Path(store).exists()):
        known = known_from(canonical(str(problem)), Path(store), criteria)
        found = _from_rows(known, criteria)
    if found is None and seconds > 0.0:
        found = _measured(str(problem), criteria, seconds, store)
    found = found or _from_features(loaded, criteria, read_database(None if database is None else Path(database)), known)
    note = "" if found.taken is None or loaded.note_on_scales in found.text else f" {loaded.note_on_scales}"
    return replace(found, text=f"{found.text}{note}")


@dataclass(frozen=True, kw_only=True)
class Known:
    """Evidence from the rows of one problem for one set of criteria."""

    problem: str  #: canonical spec
    fronts: tuple[Front, ...]  #: one an accuracy, the loosest first; none without rows
    on: str  #: what the fronts compare
    refusal: str  #: why it is not time, where time was asked for, or ""
    failed: Mapping[str, str]  #: entry -> why it does not get there
    text: str  #: the evidence, for a reader


def known_from(problem: str, store: Path, criteria: Criteria) -> Known:
    """Collect the rows of ``store`` that are up to date with today's files and libraries, as evidence."""
    rows = [row for row in load_rows(store) if row.problem == problem]
    stale = {row.key for row in outdated(rows)}
    kept = [row for row in rows if row.key not in stale]
    found = known_of(problem, kept, criteria, f"{len(kept)} runs in {store.name}")
    left_out = f"; {len(stale)} of other sources or libraries left out" if stale else ""
    return replace(found, text=f"{found.text}{left_out}")


def known_of(problem: str, rows: Sequence[RunRow], criteria: Criteria, text: str) -> Known:
    """Turn rows into evidence; times of other machines are replaced by evaluations; ``text`` describes the rows."""
    refusal = _foreign(rows) if criteria.on == "time" else ""
    criteria = replace(criteria, on="evaluations") if refusal else criteria
    fronts = as_run(CostsSoFar.of(newest(rows).rows, criteria).fronts)
    failed = {entry: why.text for front in fronts for entry, why in front.missing.items() if why.kind not in UNKNOWN}
    if fronts and not any(front.costs for front in fronts):
        text += " do not get there" + "".join(f"; {entry}: {why}" for entry, why in failed.items())
    return Known(problem=problem, fronts=fronts, on=criteria.on, refusal=refusal, failed=failed, text=text)


def _foreign(rows: Sequence[RunRow]) -> str:
    """Return why the times of these rows do not apply here, or ""."""
    good = [row for row in rows if row.success]
    found = [foreign(row.timing.get("machine", clock_of(row.environment)), versions_of(row.environment)) for row in good]
    others = [why for why in found if why]
    return f"{len(others)} of {len(found)} runs are of {others[0]}" if others else ""


def _advice(problem: str, solvers: Sequence[tuple[str, str]], **fields: str) -> Advice:
    """Make an Advice from ``solvers``, pairs of spec and what is refined, cheapest first."""
    (taken, taken_by), (second, second_by), *_ = [*solvers, (None, None), (None, None)]
    return Advice(problem=problem, taken=taken, taken_by=taken_by, second=second, second_by=second_by, **fields)


def _from_rows(known: Known, criteria: Criteria) -> Advice | None:
    """Advise from runs of the problem itself; None if they do not reach the error."""
    ranked = ranking(known.fronts)
    if not ranked:
        return None
    runs = {cost.entry: cost.run for front in known.fronts for cost in front.costs}
    return _advice(
        known.problem,
        [(spec_of(runs[entry]), kind_of(runs[entry])) for entry, _ in ranked],
        on=known.on,
        text=sentence(known.fronts, criteria),
        evidence=known.text,
        domain=f"this problem, error {criteria.accuracies[0]:g}",
        reason=f"{_refused(known.refusal)}the least {known.on} of {len(ranked)} that get there",
    )


def _measured(spec: str, criteria: Criteria, seconds: float, store: str | Path | None) -> Advice:
    """Advise from a trade run now."""
    found = trade(spec, accuracies=criteria.accuracies, seconds=seconds, drift=criteria.drift, on=criteria.on, store=store)
    evidence = f"{len(found.rows)} runs made now, {found.seconds:.0f} s"
    made = _from_rows(known_of(found.problem, found.rows, criteria, evidence), criteria)
    none = _advice(found.problem, [], on=criteria.on, text="", evidence=evidence, domain="", reason="")
    return replace(made or none, text=found.sentence)


def _refused(why: str) -> str:
    return f"times are refused: {why}; by evaluations; " if why else ""


def _from_features(problem: Problem, criteria: Criteria, database: Database, known: Known | None) -> Advice:
    """Advise from the most similar known problems, among the solvers that have not failed on this one."""
    failed = {} if known is None else known.failed
    database = database.of_entries(lambda entry: entry not in failed)
    refusal = database.refusal() if criteria.on == "time" else ""
    criteria = replace(criteria, on="evaluations") if refusal else criteria
    doubt, features, found = _outside(problem, criteria), "", None
    if not database.entries:
        doubt = "all solvers of the database have failed on this problem"
    if not doubt:
        try:
            looked = probe(problem).features
        except Exception as error:  # noqa: BLE001 - a user's functions
            doubt = str(error) if isinstance(error, ProblemError) else f"{type(error).__name__}: {error}"
        else:
            found, features = expected(database, Space.of(database), looked, criteria), str(looked)
            doubt = found.doubt
    sure = None if doubt else found
    nearest = f", nearest: {', '.join(found.neighbours[:3])}" if found else ""
    evidence = f"{len(database.scenes)} known problems{nearest}"
    domain = f"errors {ERRORS}"
    if found is not None and found.order and not found.unknown:
        domain += f"; distance {found.distance:.2g} of at most {found.reach:.2g}; {found.agreed:.0%} of the neighbours agree"
    return _advice(
        problem.name,
        [asked_of(entry) for entry, _ in sure.order] if sure else [],
        on=criteria.on,
        text=_text(sure, criteria) if sure else f"Cannot tell: {doubt.rstrip('.')}; `hhtbench trade` measures it.",
        evidence=evidence if known is None else f"{known.text}; {evidence}",
        domain=domain,
        reason=f"{_refused(refusal)}{features}".removesuffix("; "),
    )


def _outside(problem: Problem, criteria: Criteria) -> str:
    """Return why the database has no data for such criteria, or ""."""
    accuracy = criteria.accuracies[0]
    if not min(ACCURACIES) <= accuracy <= max(ACCURACIES):
        return f"the database knows errors from {ERRORS}; asked was {accuracy:g}"
    if criteria.drift is not None and criteria.drift < TIGHTEST:
        return f"the database knows drifts of at most {TIGHTEST:g}; asked was {criteria.drift:g}"
    if criteria.on == "time" and isinstance(problem.system, NumpySystem):
        return "the system's functions are called in Python, and the database's times are of machine code"
    return ""


def _text(found: Expectation, criteria: Criteria) -> str:
    (first, own), *others = found.order
    text = (
        f"Take {first}: on the {len(found.neighbours)} most similar known problems (the mean of all counts as one more) it "
        f"costs {own:.2g} times the least {criteria.on} in the mean at {_compared(criteria)}; "
    )
    return text + (f"the second choice, {others[0][0]}, {others[0][1]:.2g} times." if others else "no other is known.")


def _compared(criteria: Criteria) -> str:
    """Describe the error and drift of the database's runs, with those asked for if they differ."""
    accuracy, (_, bound) = criteria.accuracies[0], key_of(criteria)
    error = error_of(accuracy)
    text = f"an error of {error:g}" + (f" (asked: {accuracy:g})" if error != accuracy else "")
    if criteria.drift is None:
        return text
    held = "any drift" if bound is None else f"a drift of at most {bound:g}"
    return f"{text} and {held}" + (f" (asked: {criteria.drift:g})" if bound != criteria.drift else "")
