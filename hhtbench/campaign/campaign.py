"""A campaign: the accuracy pass over all cells at once, then the timing pass over one cell at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from hhtbench.campaign.execute import Limits, Pool
from hhtbench.campaign.machine import machine_facts
from hhtbench.campaign.plan import Campaign, Cell, plan_cells
from hhtbench.result import Status
from hhtbench.store import RunRow, Store

Progress = Callable[[str, int, int], None]  #: pass, cells done, cells to do


@dataclass(frozen=True, kw_only=True)
class Done:
    """What a campaign came to."""

    cells: int
    ran: int  #: cells run now; the others were there
    timed: int  #: cells timed now
    rows: tuple[RunRow, ...]  #: the row of every cell, in the order of the plan


def run_campaign(
    campaign: Campaign, store: Store, *, limits: Limits, timing: bool = True, progress: Progress | None = None
) -> Done:
    """Run what ``store`` does not hold yet; every cell is on the disk before it counts as done."""
    cells = plan_cells(campaign)
    tell = progress or (lambda *_: None)
    with Pool(limits) as pool:
        ran = _accuracy_pass(cells, store, pool, tell)
        timed = _timing_pass(cells, store, pool, campaign.repeats, tell) if timing else 0
    rows = tuple(row for row in (store.get(cell.key) for cell in cells) if row is not None)
    return Done(cells=len(cells), ran=ran, timed=timed, rows=rows)


def _accuracy_pass(cells: tuple[Cell, ...], store: Store, pool: Pool, tell: Progress) -> int:
    pending = tuple(cell for cell in cells if not _finished(cell, store))
    facts = machine_facts()
    done = 0

    def keep(cell: Cell, result: dict[str, Any]) -> None:
        nonlocal done
        row = RunRow(
            key=cell.key, problem=cell.problem, solver=cell.solver, request=cell.request, environment=facts, **result
        )
        store.put(row, cell.identity)
        done += 1
        tell("accuracy", done, len(pending))

    tell("accuracy", 0, len(pending))
    pool.run(pending, keep)
    return len(pending)


def _timing_pass(cells: tuple[Cell, ...], store: Store, pool: Pool, repeats: int, tell: Progress) -> int:
    rows = {cell.key: store.get(cell.key) for cell in cells}
    pending = tuple(cell for cell in cells if _untimed(rows[cell.key]))
    done = 0

    def keep(cell: Cell, result: dict[str, Any]) -> None:
        nonlocal done
        row = rows[cell.key]
        if row is not None:
            note = result.get("note") or (f"{result['status']}: {result['message']}" if "status" in result else None)
            timed = {"repeats": 0, "note": note} if note else result
            store.put(replace(row, timing={**row.timing, **timed}), cell.identity)
        done += 1
        tell("timing", done, len(pending))

    tell("timing", 0, len(pending))
    pool.run(pending, keep, repeats=repeats, at_once=1)
    return len(pending)


def _finished(cell: Cell, store: Store) -> bool:
    """There is a row, and it would not come out otherwise with the budget given now."""
    row = store.get(cell.key)
    if row is None:
        return False
    return row.status != Status.deadline.label or row.request["max_seconds"] >= cell.request["max_seconds"]


def _untimed(row: RunRow | None) -> bool:
    return row is not None and row.success and row.timing.get("repeats") is None
