"""``hhtbench.run``: a campaign from Python, and its rows as a list, a CSV file or a data frame."""

from __future__ import annotations

import csv
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hhtbench.analysis.cells import points
from hhtbench.campaign.campaign import run_campaign
from hhtbench.campaign.execute import machine_limits
from hhtbench.campaign.files import named_campaign
from hhtbench.campaign.plan import Campaign, Grid, restrict
from hhtbench.errors import ProblemError
from hhtbench.store import RunRow, Store


@dataclass(frozen=True)
class Runs:
    """What a campaign came to; ``hhtbench.analysis`` has functions from ``rows`` to tables, fronts and curves."""

    rows: tuple[RunRow, ...]  #: one a solve, in the order of the campaign

    def table(self) -> list[dict[str, Any]]:
        """The numbers that every table of the report starts from, one dict a row; None where nothing is known.

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
        """Write :meth:`table` to ``file``, with a line of names."""
        with Path(file).open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, NAMES)
            writer.writeheader()
            writer.writerows(self.table())

    def to_pandas(self) -> Any:
        """:meth:`table` as a ``pandas.DataFrame``.

        Raises
        ------
        ImportError
            pandas is not installed.
        """
        import pandas

        return pandas.DataFrame(self.table(), columns=list(NAMES))


NUMBERS = ("error", "time", "evaluations", "position", "velocity")
NAMES = ("problem", "solver", "setting", "value", "status", "message", *NUMBERS)


def run(
    problems: Sequence[str] | str = (),
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
        Specs, one or several; with ``campaign`` those of its own to which it is restricted.
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
    chosen = _campaign(_specs(problems), _specs(solvers), campaign, fields)
    with tempfile.TemporaryDirectory() as folder, Store(Path(folder) / "runs.sqlite" if store is None else store) as rows:
        done = run_campaign(chosen, rows, limits=machine_limits(jobs), timing=timing, executor=executor)
    return Runs(done.rows)


def _campaign(
    problems: tuple[str, ...], solvers: tuple[str, ...], campaign: str | Campaign | None, fields: dict[str, Any]
) -> Campaign:
    of_campaign = {name: _value(value) for name, value in fields.items() if name in Campaign.__dataclass_fields__}
    of_grid = {name: _value(value) for name, value in fields.items() if name in Grid.__dataclass_fields__}
    unknown = sorted(set(fields) - set(of_campaign) - set(of_grid))
    if unknown:
        known = sorted({*Campaign.__dataclass_fields__, *Grid.__dataclass_fields__} - {"grids", "problems", "solvers"})
        raise TypeError(f"run does not know {', '.join(unknown)}; known: {', '.join(known)}.")
    if campaign is None:
        return Campaign(grids=(Grid(problems=problems, solvers=solvers, **of_grid),), **of_campaign)
    if of_grid:
        raise ProblemError(f"a campaign has its own {', '.join(of_grid)}; leave them out.")
    found = named_campaign(campaign) if isinstance(campaign, str) else campaign
    return replace(restrict(found, problems, solvers), **of_campaign)


def _specs(given: Sequence[str] | str) -> tuple[str, ...]:
    return (given,) if isinstance(given, str) else tuple(given)


def _value(value: Any) -> Any:
    """A list as the tuple that a frozen campaign holds."""
    return tuple(value) if isinstance(value, (list, tuple)) or hasattr(value, "tolist") else value
