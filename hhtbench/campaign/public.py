"""``hhtbench.run``: a campaign from Python, and its rows as a list, a CSV file or a data frame."""

from __future__ import annotations

import csv
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hhtbench.campaign.analysis.cells import points
from hhtbench.campaign.asked import campaign_of
from hhtbench.campaign.campaign import run_campaign
from hhtbench.campaign.execute import machine_limits
from hhtbench.campaign.objects import ThisProcess, named
from hhtbench.campaign.plan import Campaign
from hhtbench.campaign.store import RunRow, Store
from hhtbench.catalogue.registry import holding
from hhtbench.protocol.arguments import positive_integer
from hhtbench.protocol.printing import Printed
from hhtbench.protocol.problem import Problem


@dataclass(frozen=True)
class Runs(Printed):
    """Rows of a campaign; ``hhtbench.campaign.analysis`` has functions from ``rows`` to tables, fronts and curves."""

    rows: tuple[RunRow, ...]  #: one a solve, in the order of the campaign

    def __repr__(self) -> str:
        counts = ", ".join(f"{count} {status}" for status, count in Counter(row.status for row in self.rows).most_common())
        return f"<Runs: {len(self.rows)} rows{': ' if counts else ''}{counts}>"

    def table(self) -> list[dict[str, Any]]:
        """Return one dict per row with the numbers that the report's tables start from; None if not known.

        ``problem``, ``solver``, ``setting`` ("rtol", "step" or "steps") and its ``value``, ``status``, ``message``,
        ``error`` (largest scaled error of q and v), ``time`` [s], ``evaluations``, ``position`` and ``velocity`` (drift).
        """
        found = []
        for row, point in zip(self.rows, points(self.rows), strict=True):
            setting = point.setting
            value = setting.value if setting.kind != "steps" else round(1 / setting.value)
            found.append(
                {
                    "problem": row.problem,
                    "solver": row.solver,
                    "setting": setting.kind,
                    "value": value,
                    "status": row.status,
                    "message": row.message,
                    **{name: getattr(point, name) for name in NUMBERS},
                }
            )
        return found

    def to_csv(self, file: str | Path) -> None:
        """Write :meth:`table` to ``file`` as CSV with a header."""
        with Path(file).open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, NAMES)
            writer.writeheader()
            writer.writerows(self.table())

    def to_pandas(self) -> Any:
        """Return :meth:`table` as a ``pandas.DataFrame``.

        Raises
        ------
        ImportError
            pandas is not installed.
        """
        import pandas

        return pandas.DataFrame(self.table(), columns=list(NAMES))


LISTS = ("accuracies", "grids", "rtol", "step", "steps")
NUMBERS = ("error", "time", "evaluations", "position", "velocity")
NAMES = ("problem", "solver", "setting", "value", "status", "message", *NUMBERS)


def run(
    problems: Sequence[str | Problem] | str | Problem = (),
    solvers: Sequence[str] | str = (),
    *,
    campaign: str | Campaign | None = None,
    store: str | Path | None = None,
    jobs: int | None = None,
    timing: bool = True,
    executor: Any = None,
    **fields: Any,
) -> Runs:
    """Run problems x solvers, each solve in a worker process, as ``hhtbench run`` does.

    Parameters
    ----------
    problems, solvers
        Specs, one or several; with ``campaign`` those of its own to which it is restricted.  A problem may be a Problem:
        where no imported file holds it, all is run in this process, without ``store`` and ``executor``; a warning says so.
    campaign
        A name (quick, full), a file that ends in .toml, or a Campaign.
    store
        SQLite file that keeps the rows: what it holds is not run again.  None: nothing is kept.
    jobs
        Worker processes; None: one a core.
    timing
        Whether successes are timed again, one at a time.
    executor
        A ``concurrent.futures.Executor`` for all but the timing; None: worker processes here.
    fields
        Of :class:`~hhtbench.campaign.plan.Campaign` (``accuracies=[1e-2, 1e-4]``, ``max_seconds=5``, ...) and, without
        ``campaign``, of :class:`~hhtbench.campaign.plan.Grid` (``rtol=[1e-3, 1e-5]``, ``steps=[100, 200]``).

    Raises
    ------
    NotFoundError, ProblemError, TypeError
        Wrong use, before anything runs.
    """
    if executor is not None and not callable(getattr(executor, "submit", None)):
        raise TypeError(f"executor must be a concurrent.futures.Executor; got {executor!r}.")
    jobs = None if jobs is None else positive_integer("jobs", jobs)
    found = named(problems if isinstance(problems, (list, tuple)) else [problems], store=store, executor=executor)
    with (
        holding(found.held),
        tempfile.TemporaryDirectory() as folder,
        Store(Path(folder) / "runs.sqlite" if store is None else store) as rows,
    ):
        values = {name: _value(name, value) for name, value in fields.items()}
        chosen = campaign_of(found.specs, _solvers(solvers), campaign, values)
        pool = ThisProcess() if found.held else executor
        done = run_campaign(chosen, rows, limits=machine_limits(jobs), timing=timing, executor=pool)
    return Runs(done.rows)


def _solvers(given: Sequence[str] | str) -> tuple[str, ...]:
    some = (given,) if isinstance(given, str) else given
    if not isinstance(some, (list, tuple)) or not all(isinstance(text, str) for text in some):
        raise TypeError(f"solvers must be specs, as text, since other processes load them; got {given!r}.")
    return tuple(some)


def _value(name: str, value: Any) -> Any:
    """Convert a list or array to the tuple that a frozen campaign holds."""
    if name not in LISTS:
        return value.item() if isinstance(value, np.generic) else value
    if not isinstance(value, (list, tuple)) and np.ndim(value) != 1:
        raise TypeError(f"{name} must be a list, {name}=[...]; got {value!r}.")
    return tuple(value.tolist() if isinstance(value, np.ndarray) else value)
