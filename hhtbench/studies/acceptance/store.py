"""Rows about the store and the runner of campaigns: tests of their own hold them."""

from __future__ import annotations

from hhtbench.studies.acceptance.rows import tested

EXECUTE, STORE, PLAN = "tests/campaign/test_execute.py", "tests/campaign/test_store.py", "tests/campaign/test_plan.py"


K1 = tested(
    "K1",
    "kill -9 of the runner at random moments",
    "nothing acknowledged is lost, doubled or changed",
    f"{EXECUTE}::test_kill_9_of_the_runner_loses_nothing_acknowledged_and_leaves_no_worker",
)
K2 = tested(
    "K2",
    "kill -9 of a worker, SEGV, OOM, hang in C",
    "the cell fails or is retried with its reason; others unaffected",
    f"{EXECUTE}::test_a_cell_that_crashes_hangs_raises_or_lies_costs_itself_only, "
    "::test_a_cell_whose_worker_somebody_has_killed_runs_again",
)
K3 = tested(
    "K3",
    "disk full, read-only, EIO",
    "the runner stops with a message, nothing acknowledged is lost",
    f"{STORE}::test_a_store_that_cannot_be_written_says_so_and_keeps_its_rows",
)
K4 = tested(
    "K4",
    "one flipped byte anywhere",
    "detected or harmless; affected cells repeated",
    f"{STORE}::test_no_flipped_byte_is_used_silently",
)
K5 = tested(
    "K5",
    "database truncated, or copied alone",
    "detected; only whole rows are used",
    f"{STORE}::test_a_truncated_file_is_set_aside_and_only_rows_that_are_whole_are_used",
    gap="a -wal that is deleted, the database copied alone; no count of rows or chain of hashes is asked for",
)
K6 = tested(
    "K6",
    "two runners; stale lock",
    "the second is refused, a stale lock is taken over",
    f"{STORE}::test_a_second_writer_is_refused_and_the_lock_ends_with_the_first",
)
K7 = tested(
    "K7",
    "power loss at a write",
    "acknowledged rows are present, the file opens",
    f"{STORE}::test_rows_are_on_the_disk_when_put_returns, ::test_what_a_killed_writer_had_begun_is_rolled_back",
)
K8 = tested(
    "K8",
    "resume of an unchanged campaign",
    "0 cells run",
    f"{EXECUTE}::test_successes_are_timed_once_and_a_resumed_campaign_runs_nothing",
)
K9 = tested(
    "K9",
    "changed problem, solver version or option",
    "only the touched cells run",
    f"{PLAN}::test_a_change_of_a_file_behind_a_cell_changes_its_key, ::test_another_version_of_a_library_changes_the_key",
)
K10 = tested(
    "K10",
    "a cell that kills every worker",
    "a limited number of attempts, then failed; the campaign ends",
    f"{EXECUTE}::test_a_cell_that_crashes_hangs_raises_or_lies_costs_itself_only",
    gap="that there are three attempts: they are not counted",
)
K11 = tested(
    "K11",
    "1e5 cells",
    "the cost of one does not grow with their number",
    "tests/campaign/test_waiting.py::test_the_work_of_handing_out_one_task_does_not_grow_with_their_number",
    gap="that appending a row stays below 5 ms and an fsync at 1e5 rows: only the handing out of tasks is counted",
)
K12 = tested(
    "K12",
    "SQLite before 3.51.3",
    "one connection; the version is stored with the results",
    f"{STORE}::test_two_runners_by_two_names_of_one_file_are_kept_apart",
    gap="that the version is stored with the results, and what an old version does: there is one writer by one lock",
)
