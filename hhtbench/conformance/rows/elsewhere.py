"""Rows A1 to A3, K1 to K12: separate processes, changed results, the store.

The store and the runner of campaigns are covered by tests, which these rows name.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import hhtbench as hb
from hhtbench.conformance.entry import Finding, Kind, Lane, Outcome, tested
from hhtbench.conformance.rows import random_faults
from hhtbench.conformance.rows.judging import Cases, ends, row
from hhtbench.conformance.subject import Subject
from hhtbench.runtime.processes import worker_processes

PATIENCE = 1_800.0  # s for some 220 cases, of which each may take 20 s: few do


@row(
    "A1",
    "the random systems of R8 and the faults of R9, in a process of its own for every solver",
    "no hang, no crash reaches the caller; silent errors are caught",
    lane=Lane.slow,
    gap="the 150 cases of the matrix' table, each in a process of its own",
)
def apart_from_the_caller(subject: Subject) -> Finding:
    """Yield the cases of row A1: the random systems of R8 and the faults of R9, in a process of its own for every solver.

    It ends by itself with its outcomes, of which none fails: R8 tells hangs and what is wrong in silence.
    """
    with worker_processes(1) as pool:
        (worker,) = pool.workers
        try:
            found = [worker.call(_alone, name, subject.name, seconds=PATIENCE) for name in ("random_cases", "causes")]
        except (TimeoutError, EOFError) as ended:
            return Finding(measured=f"hangs or crashes: {ended}", holds=False)
    text = "; ".join(f"{x.id} {x.kind.label}: {x.message}" for x in found)
    failing = tuple(case for x in found for case in x.failing)
    return Finding(measured=text, holds=all(x.kind is Kind.right for x in found), failing=failing)


def _alone(name: str, column: str) -> Outcome:
    found: Outcome = getattr(random_faults, name).entry.run(Subject.column(column))
    return found


@dataclass
class Changed:
    """A solver whose results are changed before they are returned."""

    of: Any
    change: Callable[[hb.Solution], hb.Solution]
    name: str = "changed"

    def accepts(self, problem: hb.Problem, request: hb.Request) -> str | None:
        """Return the answer of the wrapped solver."""
        return self.of.accepts(problem, request)

    def solve(self, problem: hb.Problem, request: hb.Request) -> hb.Solution:
        """Return the changed result of the wrapped solver."""
        return self.change(self.of.solve(problem, request))


def _rows(x: hb.Solution, change: Callable[[np.ndarray], np.ndarray], *names: str) -> hb.Solution:
    changed: Any = {name: change(getattr(x, name)) for name in names}
    return replace(x, **changed)


CHANGES: dict[str, Callable[[hb.Solution], hb.Solution]] = {
    "a value that is not finite": lambda x: _rows(x, lambda q: np.vstack([q[:2], q[2:3] * np.nan, q[3:]]), "q"),
    "the last time": lambda x: replace(x, t=x.t * 0.99),
    "off the constraints": lambda x: replace(x, q=x.q + np.linspace(0, 0.1, x.t.size)[:, None] * x.q),
    "off the tangent": lambda x: replace(x, v=x.v + np.linspace(0, 3, x.t.size)[:, None] * x.q),
    "frozen at the start": lambda x: _rows(x, lambda rows: np.repeat(rows[:1], x.t.size, axis=0), "q", "v", "lam", "mu"),
    "one ulp short": lambda x: replace(x, t=np.append(x.t[:-1], np.nextafter(x.t[-1], x.t[0]))),
    "a row is missing": lambda x: _rows(x, lambda rows: rows[:-1], "t", "q", "v", "lam", "mu"),
    "rows of another length": lambda x: _rows(x, lambda rows: rows[:-1], "v"),
}


@row("A2", "results not finite, an ulp short, off constraints or tangent, frozen, rows missing", "status unreliable")
def changed_results(subject: Subject) -> Cases:
    """Yield the cases of row A2: results not finite, an ulp short, off constraints or tangent, frozen, rows missing.

    Each change is made in what the solver returns; as it is it is believed.
    """
    given = subject.scene("position").problem
    for rows, times in {"9 rows": np.linspace(*given.t_span, 9), "every step": None}.items():
        yield f"as it is, {rows}", ends(subject.ask(given, rtol=1e-6, t_eval=times), hb.Status.success)
        for case, change in CHANGES.items():
            if times is not None or case != "a row is missing":  # the number of its own steps is not known
                found = hb.solve(given, Changed(subject.fresh(), change), rtol=1e-6, t_eval=times)
                yield f"{case}, {rows}", ends(found, hb.Status.unreliable)


EXECUTE, STORE, PLAN = (f"tests/campaign/test_{name}.py::test_" for name in ("execute", "store", "plan"))
RUNS, DISK, DAMAGE = (f"tests/campaign/test_{name}.py::test_" for name in ("run_faults", "disk_faults", "damage"))
COSTS_ITSELF = f"{EXECUTE}a_cell_that_crashes_hangs_raises_or_lies_costs_itself_only"
RUNS_AGAIN = f"{EXECUTE}what_a_cell_does_to_its_worker_harms_no_other"
BY_TESTS = (
    tested(
        "A3",
        "agreement of at least three references on each benchmark scene",
        "within 10 tolerances before it counts as reference (`hhtbench validate --all` solves them anew)",
        "tests/problems/test_references.py",
        "tests/reference/test_certify.py",
    ),
    tested(
        "K1",
        "kill -9 of the runner at random moments",
        "nothing acknowledged is lost, doubled or changed",
        f"{EXECUTE}kill_9_of_the_runner_loses_nothing_acknowledged_and_leaves_no_worker",
        f"{RUNS}fifty_kills_of_runners_their_groups_and_workers_lose_double_and_change_nothing",
    ),
    tested(
        "K2",
        "kill -9 of a worker, SEGV, OOM, hang in C",
        "the cell fails or is retried with its reason; others unaffected",
        COSTS_ITSELF,
        RUNS_AGAIN,
    ),
    tested(
        "K3",
        "disk full, read-only, EIO",
        "the runner stops with a message, nothing acknowledged is lost",
        f"{STORE}a_store_that_cannot_be_written_says_so_and_keeps_its_rows",
        f"{DISK}a_disk_that_begins_to_fail_at_any_change_loses_nothing_acknowledged",
        f"{RUNS}a_run_whose_disk_fails_says_so_and_the_same_command_goes_on_once_it_works",
    ),
    tested(
        "K4",
        "one flipped byte anywhere",
        "detected or harmless; affected cells repeated",
        f"{STORE}no_flipped_byte_is_used_silently",
        f"{DAMAGE}a_flipped_bit_in_database_or_journal_of_a_killed_writer_is_told_or_harmless",
    ),
    tested(
        "K5",
        "database truncated, copied alone, an older copy in its place",
        "detected; only whole rows are used",
        f"{STORE}a_truncated_file_is_set_aside_and_only_rows_that_are_whole_are_used",
        f"{DAMAGE}without_its_journal_what_a_killed_writer_had_begun_is_not_used",
        f"{DAMAGE}a_file_that_ends_anywhere_is_told_or_harmless",
        f"{STORE}an_older_copy_of_the_file_in_its_place_is_told",
        gap="an older copy whose lock file was taken away, or a file with as many changes: there is no chain of hashes",
    ),
    tested(
        "K6",
        "two runners; stale lock",
        "the second is refused, a stale lock is taken over",
        f"{STORE}a_second_writer_is_refused_and_the_lock_ends_with_the_first",
        f"{RUNS}of_two_runners_of_one_store_the_second_is_refused_and_one_that_is_gone_is_not_waited_for",
        gap="two machines that share a folder whose file system has no locks between machines",
    ),
    tested(
        "K7",
        "power loss at a write",
        "acknowledged rows are present, the file opens",
        f"{DISK}power_that_fails_now_and_then_loses_nothing_acknowledged",
        f"{DISK}power_that_fails_at_any_change_loses_nothing_acknowledged_whatever_of_the_rest_came_through",
    ),
    tested(
        "K8",
        "resume of an unchanged campaign",
        "0 cells run",
        f"{EXECUTE}successes_are_timed_once_for_a_machine_and_a_resumed_campaign_runs_nothing",
    ),
    tested(
        "K9",
        "changed problem, solver version or option",
        "only the touched cells run",
        f"{PLAN}a_change_of_a_file_behind_a_cell_changes_its_key",
        f"{PLAN}another_version_of_a_library_changes_the_key",
    ),
    tested(
        "K10",
        "a cell that kills every worker",
        "a limited number of attempts, then failed; the campaign ends",
        COSTS_ITSELF,
        RUNS_AGAIN,
    ),
    tested(
        "K11",
        "1e5 cells",
        "the cost of one does not grow with their number",
        "tests/campaign/test_waiting.py::test_the_work_of_handing_out_one_task_does_not_grow_with_their_number",
        f"{DAMAGE}the_work_of_writing_a_row_does_not_grow_with_their_number_and_stays_below_five_milliseconds",
    ),
    tested(
        "K12",
        "SQLite before 3.51.3",
        "one connection or the rollback journal; the version is stored with the results",
        f"{STORE}two_runners_by_two_names_of_one_file_are_kept_apart",
        f"{STORE}rows_are_on_the_disk_when_put_returns",
        COSTS_ITSELF,
    ),
)
