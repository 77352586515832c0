"""What a counted call costs beside an evaluation of the problem's own residual."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hhtbench.campaign import call_costs as weighing
from hhtbench.campaign import campaign as loop
from hhtbench.campaign.call_costs import COUNTERS, RESIDUAL, call_costs, clocked, often_enough, own_residual
from hhtbench.campaign.execute import Limits
from hhtbench.campaign.machine import clock_of, machine_facts
from hhtbench.counting import note_callback
from hhtbench.protocol import NumpySystem, Problem
from hhtbench.registry import load_problem, load_solver
from hhtbench.request import Request
from hhtbench.store import Entry, RunRow, Store
from tests.campaign.test_campaign import Immediate, cell

REQUEST = Request(rtol=1e-4, t_eval=np.array([0.1]))
JACOBIAN = "jacobian_evaluations"


class Seven:
    """Evaluates seven residuals of the problem for one of its own, and for a Jacobian ``force`` of the problem thrice."""

    name = "seven"

    def __init__(self, inside: int = 0) -> None:
        self.inside = inside

    def evaluates(self, problem: Any, request: Any, counter: str) -> Any:
        own = own_residual(problem)

        def call(times: int) -> None:
            own(7 * times if counter == RESIDUAL else 10 * times)
            for _ in range(self.inside):
                note_callback("force")

        return call


def test_a_call_that_is_seven_residuals_costs_seven():
    """Timed; under load a reading may be off, and so the bounds are wide."""
    found = call_costs(load_problem("andrews"), Seven(), REQUEST, COUNTERS)
    assert found == {RESIDUAL: pytest.approx(7.0, rel=0.6), JACOBIAN: pytest.approx(10.0, rel=0.6)}


def test_evaluations_that_a_jacobian_counts_by_itself_are_not_paid_twice(monkeypatch: pytest.MonkeyPatch):
    """Of plain callables every call of the force is counted: a residual with four is four, and the Jacobian holds one."""
    monkeypatch.setattr(weighing, "taken", lambda calls: [1e-6, 7e-6, 10e-6][: len(calls)])
    problem = load_problem("andrews")
    assert call_costs(problem, Seven(inside=4), REQUEST, ()) == {RESIDUAL: pytest.approx(7.0 / 4)}
    assert call_costs(problem, Seven(inside=1), REQUEST, COUNTERS) == pytest.approx({RESIDUAL: 7.0, JACOBIAN: 3.0})


def test_a_solver_that_does_not_tell_what_it_evaluates_has_no_costs():
    class Silent:
        def evaluates(self, problem: Any, request: Any, counter: str) -> None:
            return None

    problem = load_problem("simple_pendulum")
    assert call_costs(problem, object(), REQUEST, COUNTERS) == call_costs(problem, Silent(), REQUEST, COUNTERS) == {}


PLAIN = Problem(
    name="plain",
    system=NumpySystem(force=lambda t, q, v: np.array([0.0, -9.81]), constraint=lambda t, q: np.array([q @ q - 1.0]) / 2),
    t_span=(0.0, 1.0),
    q0=[1.0, 0.0],
    v0=[0.0, 0.0],
)


def test_every_kind_of_solver_tells_what_it_evaluates_of_plain_callables_too():
    for name in ("hht", "ida(form=ggl)", "cvode", "projected"):
        found = call_costs(PLAIN, load_solver(name), REQUEST, COUNTERS)
        assert set(found) == set(COUNTERS) and found[RESIDUAL] > 0.3, name


def test_an_acceleration_is_more_work_than_a_residual_of_ida():
    pendulum = load_problem("simple_pendulum")
    costs = {name: call_costs(pendulum, load_solver(name), REQUEST, COUNTERS) for name in ("hht", "ida(form=ggl)", "cvode")}
    assert all(set(found) == set(COUNTERS) and min(found.values()) > 0.5 for found in costs.values())
    assert costs["cvode"][RESIDUAL] > 2.0 * costs["ida(form=ggl)"][RESIDUAL]
    assert costs["ida(form=ggl)"][RESIDUAL] == pytest.approx(1.2, abs=0.6)


def test_machine_code_is_timed_without_python_between():
    """A call from Python takes some hundred nanoseconds, the pendulum's residual a few."""
    own = own_residual(load_problem("simple_pendulum"))
    count = often_enough(own)
    assert count > 1000
    assert min(clocked(own, count) for _ in range(5)) < 1e-7


class Scales(Immediate):
    """Weighs what it is given, and keeps what it was asked."""

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[tuple[str, ...]] = []

    limits = Limits(jobs=2)

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        future = super().submit(fn, *args, **kwargs)
        self.asked.append(args[0].weighed)
        future.result().update(call_costs={RESIDUAL: float(len(self.asked))})
        return future


def weighed(store: Store, rows: Mapping[float, Mapping[str, Any]], pool: Scales) -> list[Mapping[str, Any]]:
    """``timing`` of every row after the pass."""
    cells = [cell(rtol) for rtol in rows]
    loop._weighing_pass(cells, store, pool, lambda *_: None)
    return [found.timing for one in cells if (found := store.get(one.key)) is not None]


def test_calls_are_weighed_once_for_all_rows_of_a_pair_and_anew_on_another_machine(tmp_path: Path):
    counts = {1e-1: {"counters": {RESIDUAL: 9, JACOBIAN: 2}}, 1e-2: {"status": "deadline", "counters": {RESIDUAL: 90}}}
    pool, here = Scales(), clock_of(machine_facts())
    with Store(tmp_path / "runs.db") as store:
        for rtol, changes in counts.items():
            values = {"status": "success", "message": "", "timing": {"best_s": 1.0, "machine": here}} | changes
            one = cell(rtol)
            row = RunRow(key=one.key, problem=one.problem, solver=one.solver, request=one.request, **values)
            store.write([Entry(row=row, identity=one.identity)])
        found = weighed(store, counts, pool)
        assert [(timing["call_costs"], timing["machine"]) for timing in found] == [({RESIDUAL: 1.0}, here)] * 2
        assert weighed(store, counts, pool) == found  # resumed
        assert pool.asked == [COUNTERS]
        first = store.get(cell(1e-1).key)
        assert first is not None
        other = replace(first, timing={**first.timing, "machine": {**here, "cores": 512}})
        store.write([Entry(row=other, identity=cell(1e-1).identity, replaces=True)])
        again = weighed(store, counts, pool)
    assert [timing["call_costs"] for timing in again] == [{RESIDUAL: 2.0}] * 2
    assert [timing["best_s"] for timing in again] == [None, 1.0]  # no time of the other machine stays
