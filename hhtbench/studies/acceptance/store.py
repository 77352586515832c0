"""Rows about the store and the runner of campaigns: tests of their own hold them."""

from __future__ import annotations

from hhtbench.studies.acceptance.rows import tested

EXECUTE, STORE, PLAN = "tests/campaign/test_execute.py", "tests/campaign/test_store.py", "tests/campaign/test_plan.py"
RUNS, DISK, DAMAGE = (f"tests/campaign/test_{name}.py" for name in ("run_faults", "disk_faults", "damage"))


K1 = tested(
    "K1",
    "kill -9 of the runner at random moments",
    "nothing acknowledged is lost, doubled or changed",
    f"{EXECUTE}::test_kill_9_of_the_runner_loses_nothing_acknowledged_and_leaves_no_worker",
    f"{RUNS}::test_fifty_kills_of_runners_their_groups_and_workers_lose_double_and_change_nothing",
)
K2 = tested(
    "K2",
    "kill -9 of a worker, SEGV, OOM, hang in C",
    "the cell fails or is retried with its reason; others unaffected",
    f"{EXECUTE}::test_a_cell_that_crashes_hangs_raises_or_lies_costs_itself_only",
    f"{EXECUTE}::test_a_cell_whose_worker_somebody_has_killed_runs_again",
)
K3 = tested(
    "K3",
    "disk full, read-only, EIO",
    "the runner stops with a message, nothing acknowledged is lost",
    f"{STORE}::test_a_store_that_cannot_be_written_says_so_and_keeps_its_rows",
    f"{DISK}::test_a_disk_that_begins_to_fail_at_any_change_loses_nothing_acknowledged",
    f"{RUNS}::test_a_run_whose_disk_fails_says_so_and_the_same_command_goes_on_once_it_works",
)
K4 = tested(
    "K4",
    "one flipped byte anywhere",
    "detected or harmless; affected cells repeated",
    f"{STORE}::test_no_flipped_byte_is_used_silently",
    f"{DAMAGE}::test_a_flipped_bit_in_database_or_journal_of_a_killed_writer_is_told_or_harmless",
)
K5 = tested(
    "K5",
    "database truncated, copied alone, an older copy in its place",
    "detected; only whole rows are used",
    f"{STORE}::test_a_truncated_file_is_set_aside_and_only_rows_that_are_whole_are_used",
    f"{DAMAGE}::test_without_its_journal_what_a_killed_writer_had_begun_is_not_used",
    f"{DAMAGE}::test_a_file_that_ends_anywhere_is_told_or_harmless",
    f"{STORE}::test_an_older_copy_of_the_file_in_its_place_is_told",
    gap="an older copy whose lock file was taken away, or a file with as many changes: there is no chain of hashes",
)
K6 = tested(
    "K6",
    "two runners; stale lock",
    "the second is refused, a stale lock is taken over",
    f"{STORE}::test_a_second_writer_is_refused_and_the_lock_ends_with_the_first",
    f"{RUNS}::test_of_two_runners_of_one_store_the_second_is_refused_and_one_that_is_gone_is_not_waited_for",
    gap="two machines that share a folder whose file system has no locks between machines",
)
K7 = tested(
    "K7",
    "power loss at a write",
    "acknowledged rows are present, the file opens",
    f"{DISK}::test_power_that_fails_now_and_then_loses_nothing_acknowledged",
    f"{DISK}::test_power_that_fails_at_any_change_loses_nothing_acknowledged_whatever_of_the_rest_came_through",
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
    f"{PLAN}::test_a_change_of_a_file_behind_a_cell_changes_its_key",
    f"{PLAN}::test_another_version_of_a_library_changes_the_key",
)
K10 = tested(
    "K10",
    "a cell that kills every worker",
    "a limited number of attempts, then failed; the campaign ends",
    f"{EXECUTE}::test_a_cell_that_crashes_hangs_raises_or_lies_costs_itself_only",
    f"{EXECUTE}::test_a_cell_whose_worker_somebody_has_killed_runs_again",
)
K11 = tested(
    "K11",
    "1e5 cells",
    "the cost of one does not grow with their number",
    "tests/campaign/test_waiting.py::test_the_work_of_handing_out_one_task_does_not_grow_with_their_number",
    f"{DAMAGE}::test_the_work_of_writing_a_row_does_not_grow_with_their_number_and_stays_below_five_milliseconds",
)
K12 = tested(
    "K12",
    "SQLite before 3.51.3",
    "one connection or the rollback journal; the version is stored with the results",
    f"{STORE}::test_two_runners_by_two_names_of_one_file_are_kept_apart",
    f"{STORE}::test_rows_are_on_the_disk_when_put_returns",
    f"{EXECUTE}::test_a_cell_that_crashes_hangs_raises_or_lies_costs_itself_only",
)
