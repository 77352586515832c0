"""``hhtbench.select``: whom to take for one error on one problem, by the best evidence there is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from hhtbench.advice.database import ACCURACIES, HELD, Database, read_database
from hhtbench.advice.features import probe
from hhtbench.advice.known import Known
from hhtbench.advice.nearest import Expectation, Space, error_of, expected, key_of
from hhtbench.advice.trading import trade
from hhtbench.advice.verdict import ranking, sentence
from hhtbench.advice.wish import Wish
from hhtbench.analysis.cells import Point, asked_of, kind_of, spec_of
from hhtbench.arguments import real_number
from hhtbench.errors import ProblemError
from hhtbench.protocol import NumpySystem, Problem
from hhtbench.registry import load_problem
from hhtbench.specs import canonical

TIGHTEST = HELD[1]  # bound of the drift that a database knows
OTHERWISE = "`hhtbench trade` measures it"
REFUSED = "times are refused: {why}; by evaluations"


@dataclass(frozen=True, kw_only=True)
class Advice:
    """What :func:`select` says."""

    problem: str
    taken: str | None  #: the solver with its options, as ``hb.solve`` takes it; None: it cannot be told
    taken_by: str | None  #: what ``hb.solve`` is given for the error: "rtol", or "steps" for constant ones
    second: str | None
    second_by: str | None
    on: str  #: what was compared: "time" or "evaluations"
    text: str  #: whom to take and what it costs, or why it cannot be told and what to do
    evidence: str  #: what it rests on
    domain: str  #: where that holds
    reason: str  #: in one line

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)

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
    """Say which solver reaches an error most cheaply.

    From rows of the problem where ``store`` holds some; else from a :func:`trade` of ``seconds``; else from the problem's
    features and a database of other problems.

    Parameters
    ----------
    problem
        A spec; a Problem where neither rows nor runs are asked for.
    accuracy
        Error of q and v, scaled by the problem's scales.
    drift
        Most scaled drift of position and velocity constraints; None: any.
    on
        What shall be little: "time" or "evaluations".  Times of another machine, or of other versions, are refused;
        evaluations take their place then, and the text says so.
    seconds
        What measuring may take [s]; 0: nothing is run.
    store
        SQLite file of ``run`` or ``trade``.
    database
        Made by ``hhtbench study selection``; None: that of the package.

    Raises
    ------
    NotFoundError, ProblemError, TypeError
        Wrong use.
    """
    wish = Wish(accuracies=(accuracy,), on=on, drift=drift)
    if real_number("seconds", seconds) < 0.0:
        raise ProblemError(f"seconds must not be negative; got {seconds:g}.")
    if not isinstance(problem, str) and (store is not None or seconds > 0.0):
        raise TypeError("rows and runs belong to a spec, as text; give one, or leave store and seconds out.")
    loaded, known = load_problem(problem), _known(problem, wish, store, absent=seconds > 0.0)
    found = None if known is None else _from_rows(known, wish)
    if found is None and isinstance(problem, str) and seconds > 0.0:
        found = _measured(problem, wish, seconds, store)
    found = found or _from_features(loaded, wish, read_database(None if database is None else Path(database)), known)
    note = "" if found.taken is None or loaded.note_on_scales in found.text else f" {loaded.note_on_scales}"
    return replace(found, text=f"{found.text}{note}")


def _known(problem: str | Problem, wish: Wish, store: str | Path | None, *, absent: bool) -> Known | None:
    """What the rows of ``store`` tell; ``absent``: it may still have to be made."""
    if store is None or not isinstance(problem, str) or (absent and not Path(store).exists()):
        return None
    return Known.of(canonical(problem), Path(store), wish)


def _from_rows(known: Known, wish: Wish) -> Advice | None:
    """By runs of the problem itself; None where they do not reach the error."""
    ranked = ranking(known.fronts)
    if not ranked:
        return None
    refused = [REFUSED.format(why=known.refusal)] if known.refusal else []
    return Advice(
        problem=known.problem,
        **_first_two([(spec_of(run), kind_of(run)) for run in (_run_of(known, entry) for entry, _ in ranked)]),
        on=known.on,
        text=sentence(known.fronts, wish),
        evidence=known.text,
        domain=f"this problem, error {wish.accuracies[0]:g}",
        reason=" ".join([*refused, f"the least {known.on} of {len(ranked)} that get there"]),
    )


def _run_of(known: Known, entry: str) -> Point:
    """A run of ``entry`` that gets to an error."""
    return next(cost.run for front in known.fronts for cost in front.costs if cost.entry == entry)


def _first_two(asked: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """The solvers of an :class:`Advice`, of ``asked``: specs and what each is given, the cheapest first."""
    (taken, taken_by), (second, second_by), *_ = [*asked, (None, None), (None, None)]
    return {"taken": taken, "taken_by": taken_by, "second": second, "second_by": second_by}


def _measured(spec: str, wish: Wish, seconds: float, store: str | Path | None) -> Advice:
    """By a trade."""
    found = trade(spec, accuracies=wish.accuracies, seconds=seconds, drift=wish.drift, on=wish.on, store=store)
    evidence = f"{len(found.rows)} runs made now, {found.seconds:.0f} s"
    told = _from_rows(Known.from_rows(found.problem, found.rows, wish, evidence), wish)
    if told is not None:
        return replace(told, text=found.sentence)
    return Advice(
        problem=found.problem,
        **_first_two([]),
        on=wish.on,
        text=found.sentence,
        evidence=evidence,
        domain="",
        reason="",
    )


def _from_features(problem: Problem, wish: Wish, database: Database, known: Known | None) -> Advice:
    """By the problems most like it, among the solvers that have not failed on this one."""
    failed = {} if known is None else known.failed
    database = database.of_entries(lambda entry: entry not in failed)
    refusal = database.refusal() if wish.on == "time" else ""
    wish = replace(wish, on="evaluations") if refusal else wish
    doubt, features, told = _outside(problem, wish), "", None
    if not database.entries:
        doubt = "all solvers of the database have failed on this problem"
    if not doubt:
        try:
            looked = probe(problem).features
        except Exception as error:  # noqa: BLE001 - a user's functions
            doubt = str(error) if isinstance(error, ProblemError) else f"{type(error).__name__}: {error}"
        else:
            told, features = expected(database, Space.of(database), looked, wish), str(looked)
            doubt = told.doubt
    sure = told if told is not None and not doubt else None
    return Advice(
        problem=problem.name,
        **_first_two([] if sure is None else [asked_of(entry) for entry, _ in sure.order]),
        on=wish.on,
        text=f"Cannot tell: {doubt.rstrip('.')}; {OTHERWISE}." if sure is None else _text(sure, wish),
        evidence="; ".join(([] if known is None else [known.text]) + [_scenes(database, told)]),
        domain=_domain(told),
        reason="; ".join(filter(None, [REFUSED.format(why=refusal) if refusal else "", features])),
    )


def _scenes(database: Database, told: Expectation | None) -> str:
    nearest = f", nearest: {', '.join(told.neighbours[:3])}" if told else ""
    return f"{len(database.scenes)} known problems{nearest}"


def _outside(problem: Problem, wish: Wish) -> str:
    """Why the database says nothing of such a wish, or ""."""
    accuracy = wish.accuracies[0]
    if not min(ACCURACIES) <= accuracy <= max(ACCURACIES):
        return f"the database knows errors from {max(ACCURACIES):g} to {min(ACCURACIES):g}; asked was {accuracy:g}"
    if wish.drift is not None and wish.drift < TIGHTEST:
        return f"the database knows drifts of at most {TIGHTEST:g}; asked was {wish.drift:g}"
    if wish.on == "time" and isinstance(problem.system, NumpySystem):
        return "the system's functions are called in Python, and the database's times are of machine code"
    return ""


def _text(told: Expectation, wish: Wish) -> str:
    (first, own), *others = told.order
    text = (
        f"Take {first}: on the {len(told.neighbours)} most similar known problems and, with equal weight, on all it costs "
        f"{own:.2g} times the least {wish.on} in the mean at {_compared(wish)}; "
    )
    return text + (f"the second choice, {others[0][0]}, {others[0][1]:.2g} times." if others else "no other is known.")


def _compared(wish: Wish) -> str:
    """The error and the drift of the database's runs, with what was asked where that is another."""
    accuracy, (_, bound) = wish.accuracies[0], key_of(wish)
    error = error_of(accuracy)
    told = f"an error of {error:g}" + (f" (asked: {accuracy:g})" if error != accuracy else "")
    if wish.drift is None:
        return told
    held = "any drift" if bound is None else f"a drift of at most {bound:g}"
    return f"{told} and {held}" + (f" (asked: {wish.drift:g})" if bound != wish.drift else "")


def _domain(told: Expectation | None) -> str:
    errors = f"errors {max(ACCURACIES):g} to {min(ACCURACIES):g}"
    if told is None or not told.order or told.unknown:
        return errors
    return f"{errors}; distance {told.distance:.2g} of at most {told.reach:.2g}; {told.agreed:.0%} of the neighbours agree"
