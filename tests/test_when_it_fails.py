"""The table of docs/statuses.md has every status and a row for each of its causes, and each of them can be provoked."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.campaign.execute import Limits, Task, WorkerPool, run_task
from hhtbench.campaign.run import run_cell
from hhtbench.conformance.scenes.linkages import DoublePendulum
from tests.hht.test_branches import HEIGHT, Loaded
from tests.hht.test_singular_positions import BARS, FLAT, stop_runs

PAGE = (Path(__file__).parent.parent / "docs/statuses.md").read_text(encoding="utf-8")
ASKED = {"rtol": None, "atol": None, "step": None, "steps": 10, "outputs": 3, "max_seconds": 10.0, "counting": False}
CRASHES = """\
import os


class Aborts:
    name = "aborts"

    def accepts(self, problem, request):
        os.abort()

    def solve(self, problem, request):
        pass


solver = Aborts()
"""


def rows() -> list[tuple[str, str]]:
    """The status, empty where it is that of the row above, and what happened, of the table's rows."""
    return re.findall(r"^\| (?:`(\w+)` )?\| (.*?) \|", PAGE.split("|---|")[-1], re.MULTILINE)


def weight(**functions: Any) -> hb.NumpySystem:
    """A weight that falls from 1 m."""
    return hb.NumpySystem(**{"force": lambda t, q, v: np.full(1, -9.81), **functions})


def fall(system: hb.NumpySystem | None = None, options: Mapping[str, Any] | None = None, **request: Any) -> Any:
    return hb.HHT(system or weight(), **options or {}).solve((0.0, 1.0), [1.0], [0.0], **request or {"step": 0.01})


def problem(**changes: Any) -> hb.Problem:
    return hb.Problem(**{"name": "fall", "system": weight(), "t_span": (0.0, 1.0), "q0": [1.0], "v0": [0.0], **changes})


def raising(error: BaseException) -> Callable[..., NoReturn]:
    def force(t: float, q: Any, v: Any) -> NoReturn:
        raise error

    return force


def left_over(error: BaseException) -> Any:
    """The partial solution of a run whose force raises ``error``."""
    with pytest.raises(type(error)) as caught:
        fall(weight(force=raising(error)))
    return caught.value.partial_solution  # type: ignore[attr-defined]


def push(t: float, q: Any, v: Any) -> Any:
    return np.full(1, -9.81 + 100.0 * np.exp(-(((t - 0.53) / 0.01) ** 2)))


def pushed() -> Any:
    return hb.solve(problem(system=weight(force=push)), "cvode", accuracy=1e-3)


def slow(t: float, q: Any, v: Any) -> Any:
    time.sleep(0.02)
    return np.full(1, -9.81)


def hoop(q0: Any = (1.0, 0.0), functions: Mapping[str, Any] | None = None, **request: Any) -> Any:
    """A weight on a hoop of radius one."""
    physics: dict[str, Any] = {
        "mass_matrix": [1.0, 1.0],
        "force": lambda t, q, v: np.array([0.0, -9.81]),
        "constraint": lambda t, q: np.array([q @ q - 1.0]),
    }
    return hb.HHT(hb.NumpySystem(**physics | dict(functions or {}))).solve((0.0, 1.0), q0, (0.0, 0.0), **request)


class Lies:
    """It calls a straight line the motion."""

    name = "straight line"

    def accepts(self, problem: Any, request: Any) -> None:
        return None

    def solve(self, problem: Any, request: Any) -> hb.Solution:
        t = np.linspace(0.0, 1.0, 11) if request.t_eval is None else request.t_eval
        none = np.zeros((t.size, 0))
        counters = hb.Counters(steps_accepted=10, residual_evaluations=10)
        q, v = 1.0 - t[:, None], np.full((t.size, 1), -1.0)
        return hb.Solution(t=t, q=q, v=v, lam=none, mu=none, status=hb.Status.success, message="", counters=counters)


class Eats(Lies):
    """It needs more memory than there is."""

    def solve(self, problem: Any, request: Any) -> hb.Solution:
        raise MemoryError("no memory for a matrix")


def cell(solver: Any, **asked: Any) -> dict[str, Any]:
    """A cell of a campaign."""
    return run_cell(problem(), solver, ASKED | asked, {}, lambda phase: None)


def crash(folder: Path) -> dict[str, Any]:
    """A cell whose worker aborts."""
    (folder / "aborts.py").write_text(CRASHES)
    task = Task(problem="simple_pendulum", solver=f"{folder / 'aborts.py'}:solver", request=ASKED)
    with WorkerPool(Limits(jobs=1)) as pool:
        return dict(pool.submit(run_task, task).result())


def ends(function: Any) -> hb.Event:
    return hb.Event(function, terminal=True)


class Case(NamedTuple):
    """One cause of a status: a row of the table."""

    row: str  #: what its row says of it
    words: str  #: what the message says
    provoke: Callable[[Path], Any]


def stiff(t: float, q: Any, v: Any) -> Any:
    return -1e4 * q


def wall(t: float, q: Any, v: Any) -> Any:
    return -1e8 * np.sign(q - 0.5)


def floor(t: float, q: Any, v: Any) -> Any:
    return -9.81 + 1e6 * np.maximum(0.5 - q, 0.0)


def noisy(t: float, q: Any, v: Any) -> Any:
    return np.full(1, -9.81 * (1.0 + 1e-5 * RANDOM.standard_normal()))


def rods(ratio: float, until: float = 1.0, alpha: float | None = None, **request: Any) -> Any:
    """A light body between two taut rods; ``alpha`` of extrapolated multipliers."""
    options = {} if alpha is None else {"alpha": alpha, "extrapolate_reaction": True}
    return hb.HHT(DoublePendulum(ratio=ratio), **options).solve((0.0, until), *DoublePendulum.straight(0.5), **request)


def uneven() -> Any:
    """A stiff spring that is hardly moved at all, by steps 1 : 10 : 1 : 10 ..."""
    steps = np.tile([1.0, 10.0], 100)
    spring = hb.NumpySystem(force=lambda t, q, v: -1e8 * q)
    return hb.HHT(spring, alpha=-0.3).solve((0.0, 1.0), [1e-12], [0.0], steps=steps / steps.sum())


def flat_bars() -> Any:
    """A run that fails beside a position of lost rank; it has an event, and so does not go across."""
    with pytest.MonkeyPatch.context() as patch:
        stop_runs(patch, FLAT - 1e-4)
        hht = hb.HHT(BARS.system, events=[hb.Event(lambda t, q, v: t - 2.0)])
        return hht.solve((0.0, 1.0), BARS.q0, BARS.v0, rtol=1e-3)


def leaving_a_rail() -> Any:
    """Two rails that touch at the start, and nowhere else."""
    rails = hb.NumpySystem(force=lambda t, q, v: np.zeros(2), constraint=lambda t, q: np.array([q[1], q[1] - q[0] ** 2]))
    return hb.HHT(rails).solve((0.0, 1.0), [0.0, 0.0], [1.0, 0.0], steps=10)


def snapping() -> Any:
    """A flat truss under a load that changes."""
    return hb.HHT(Loaded(load=1e4)).solve((0.0, 10.0), [1.0, HEIGHT, 0.0], [0.0] * 3, steps=200)


def bouncing() -> Any:
    floor = hb.Event(lambda t, q, v: q[0], direction=-1, change=lambda t, q, v: (q, -0.5 * v), name="floor")
    return hb.HHT(weight(), events=floor).solve((0.0, 10.0), [1.0], [0.0], step=0.01)


def stretched() -> Any:
    """Two bodies that fly along, with a stiff spring between them that is not in balance."""
    spring = weight(mass_matrix=[1.0, 1.0], force=lambda t, q, v: 1e6 * (q[1] - q[0]) * np.array([1.0, -1.0]))
    return hb.HHT(spring).solve((0.0, 3.0), [0.0, 1e-3], [1.0, 1.0], rtol=1e-4, max_num_steps=4_000)


RANDOM = np.random.default_rng(3)
DUPLICATED = {
    "constraint": lambda t, q: np.array([q @ q - 1.0, q @ q - 1.0]),
    "reaction": lambda t, q, lam: -2 * q * (lam[0] + lam[1]),
}
NEARLY_TWICE = {"constraint": lambda t, q: np.array([q @ q - 1.0, q @ q - 1.0 + 1e-8 * q[1]])}
PROVOKED: dict[str, list[Case]] = {
    "success": [
        Case("", "", lambda _: fall()),
        Case("do not resolve", "the steps do not resolve", lambda _: fall(weight(force=floor), step=0.01)),
    ],
    "event": [Case("", "", lambda _: hb.solve(problem(), "hht", step=0.01, events=[ends(lambda t, q, v: q[0])]))],
    "max_steps": [
        Case("", "3 steps", lambda _: fall(step=0.01, max_num_steps=3)),
        Case("vibration that constraint", "Constraint forces carry", lambda _: rods(1e8, rtol=1e-4, max_num_steps=3_000)),
        Case("vibration of forces", "Forces carry a vibration", lambda _: stretched()),
        Case("noise", "Calls of force", lambda _: fall(weight(force=noisy), rtol=1e-8, max_num_steps=1_000)),
    ],
    "step_too_small": [
        Case("jump", "jump", lambda _: fall(weight(force=lambda t, q, v: np.full(1, 1e12 * (t > 0.5))), rtol=1e-4)),
        Case("min_step", "0.1", lambda _: fall(weight(force=stiff), rtol=1e-6, options={"min_step": 0.1})),
        Case("roundoff", "roundoff is reached", lambda _: hoop(rtol=0.0, atol=1e-14)),
    ],
    "newton_failed": [
        Case("prescribed", "smaller", lambda _: fall(weight(force=wall), step=0.1)),
        Case("smallest step", "look for a jump", lambda _: fall(weight(force=wall), rtol=1e-4, options={"min_step": 0.1})),
        Case("vibration", "Constraint forces carry a vibration", lambda _: rods(1e6, step=1e-3)),
        Case("leaps", "q[1] leaps", lambda _: snapping()),
    ],
    "singular_iteration_matrix": [
        Case("mass", "mass", lambda _: fall(weight(mass_matrix=[0.0]))),
        Case("nearly depend", "rank 1 of 2 rows", lambda _: hoop(functions=NEARLY_TWICE, step=0.01)),
        Case("lose rank", "lose rank", lambda _: flat_bars()),
    ],
    "redundant_constraints": [
        Case("depend on others", "rank", lambda _: hoop(functions=DUPLICATED, step=0.01)),
        Case("violated later", "left out", lambda _: leaving_a_rail()),
    ],
    "nonfinite_callback": [
        Case("", "force[0]", lambda _: fall(weight(force=lambda t, q, v: np.full(1, np.nan if t > 0.5 else 1.0)))),
    ],
    "inconsistent_initial": [Case("", "g[0]", lambda _: hoop(q0=(1.1, 0.0), step=0.01))],
    "time_resolution": [
        Case("floating-point", "time", lambda _: hb.HHT(weight()).solve((1e9, 1e9 + 1e-6), [1.0], [0.0], step=1e-9)),
        Case("pile up", "pile up", lambda _: bouncing()),
    ],
    "evaluation_budget": [Case("", "evaluations", lambda _: fall(step=0.01, max_evaluations=5))],
    "deadline": [Case("", "seconds", lambda _: fall(weight(force=slow), step=0.01, max_seconds=0.1))],
    "accuracy_not_shown": [
        Case("event", "event", lambda _: hb.solve(problem(), "hht", accuracy=1e-3, events=[ends(lambda t, q, v: q[0])])),
        Case("stepped over", "motion disagree", lambda _: pushed()),
    ],
    "interrupted": [Case("", "", lambda _: left_over(KeyboardInterrupt()))],
    "declined": [Case("", "", lambda _: cell(hb.load_solver("rattle"), steps=None, rtol=1e-3))],
    "unreliable": [
        Case("", "", lambda _: cell(Lies())),
        Case("grow that", "(H53)", lambda _: uneven()),
    ],
    "user_exception": [Case("", "ZeroDivisionError", lambda _: left_over(ZeroDivisionError()))],
    "crashed": [Case("", "", crash)],
    "out_of_memory": [Case("", "", lambda _: cell(Eats()))],
}
CASES = [(label, case) for label, cases in PROVOKED.items() for case in cases]


def test_the_table_has_every_status_and_a_row_for_every_cause():
    labels = [label for label, _ in rows() if label]
    assert labels == [status.label for status in hb.Status] == list(PROVOKED)
    named = [label if case is PROVOKED[label][0] else "" for label, case in CASES]
    assert [label for label, _ in rows()] == named
    assert [case.row in text for (_, text), (_, case) in zip(rows(), CASES, strict=True)] == [True] * len(CASES)


@pytest.mark.parametrize(("label", "case"), CASES, ids=[f"{label}-{case.row}".rstrip("-") for label, case in CASES])
def test_every_row_is_provoked(label: str, case: Case, tmp_path: Path):
    found = case.provoke(tmp_path)
    if isinstance(found, dict):
        assert found["status"] == label
    else:
        assert found.status.label == label, found.message
        assert case.words in f"{found.message} {found.diagnose()}"
