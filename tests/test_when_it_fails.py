"""README's table "When it fails" has a row for every status, and each of them can be provoked."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.campaign.execute import Limits, Task, WorkerPool, run_task
from hhtbench.campaign.run import run_cell

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
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


def labels() -> list[str]:
    """The first cells of the table's rows."""
    section = README.split("## When it fails")[1].split("\n## ")[0]
    return re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE)


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


def slow(t: float, q: Any, v: Any) -> Any:
    time.sleep(0.02)
    return np.full(1, -9.81)


def hoop(q0: Any = (1.0, 0.0), **functions: Any) -> Any:
    """A weight on a hoop of radius one."""
    physics: dict[str, Any] = {
        "mass_matrix": [1.0, 1.0],
        "force": lambda t, q, v: np.array([0.0, -9.81]),
        "constraint": lambda t, q: np.array([q @ q - 1.0]),
    }
    return hb.HHT(hb.NumpySystem(**physics | functions)).solve((0.0, 1.0), q0, (0.0, 0.0), step=0.01)


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


PROVOKED: dict[str, Callable[[Path], Any]] = {
    "success": lambda _: fall(),
    "event": lambda _: hb.solve(problem(), "hht", step=0.01, events=[ends(lambda t, q, v: q[0])]),
    "max_steps": lambda _: fall(step=0.01, max_num_steps=3),
    "step_too_small": lambda _: fall(weight(force=lambda t, q, v: -1e4 * q), rtol=1e-6, options={"min_step": 0.1}),
    "newton_failed": lambda _: fall(weight(force=lambda t, q, v: -1e8 * np.sign(q - 0.5)), step=0.1),
    "singular_iteration_matrix": lambda _: fall(weight(mass_matrix=[0.0])),
    "redundant_constraints": lambda _: hoop(
        constraint=lambda t, q: np.array([q @ q - 1.0, q @ q - 1.0]),
        reaction=lambda t, q, lam: -2 * q * (lam[0] + lam[1]),
    ),
    "nonfinite_callback": lambda _: fall(weight(force=lambda t, q, v: np.full(1, np.nan if t > 0.5 else 1.0))),
    "inconsistent_initial": lambda _: hoop(q0=(1.1, 0.0)),
    "time_resolution": lambda _: hb.HHT(weight()).solve((1e9, 1e9 + 1e-6), [1.0], [0.0], step=1e-9),
    "evaluation_budget": lambda _: fall(step=0.01, max_evaluations=5),
    "deadline": lambda _: fall(weight(force=slow), step=0.01, max_seconds=0.1),
    "accuracy_not_shown": lambda _: hb.solve(problem(), "hht", accuracy=1e-3, events=[ends(lambda t, q, v: q[0])]),
    "interrupted": lambda _: left_over(KeyboardInterrupt()),
    "declined": lambda _: cell(hb.load_solver("rattle"), steps=None, rtol=1e-3),
    "unreliable": lambda _: cell(Lies()),
    "user_exception": lambda _: left_over(ZeroDivisionError()),
    "crashed": crash,
    "out_of_memory": lambda _: cell(Eats()),
}


def test_the_table_has_one_row_for_every_status():
    assert labels() == [status.label for status in hb.Status] == list(PROVOKED)


@pytest.mark.parametrize("label", list(PROVOKED))
def test_every_status_is_provoked(label: str, tmp_path: Path):
    found = PROVOKED[label](tmp_path)
    status = found["status"] if isinstance(found, dict) else found.status.label
    assert status == label
