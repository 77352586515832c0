"""Which worker gets which task, and that finding it costs the same however many wait."""

from __future__ import annotations

import random
import sys

import pytest

from hhtbench.campaign.waiting import ENOUGH_TO_COMPILE, WaitingTasks

A, B, C = ("fall", "hht"), ("fall", "ida"), ("chain", "hht")


def filled(*pairs: tuple[str, str]) -> WaitingTasks:
    waiting = WaitingTasks()
    for number, pair in enumerate(pairs):
        waiting.put(pair, (pair, number))
    return waiting


def test_a_worker_keeps_to_the_pairs_and_then_to_the_problems_that_it_has():
    waiting = filled(A, C, B, A)
    assert waiting.take("w")[0] == A
    assert waiting.take("w")[0] == A
    assert waiting.take("w")[0] == B  # the same problem, before C that came first
    assert waiting.take("w")[0] == C
    assert waiting.take("w") is None
    assert len(waiting) == 0


def test_a_second_worker_prefers_a_problem_that_nobody_has_then_another_pair():
    waiting = filled(A, B, C, A)
    assert waiting.take("w")[0] == A
    assert waiting.take("x")[0] == C
    assert waiting.take("y")[0] == B
    assert waiting.take("z") is None  # the rest of A waits for its worker
    assert waiting.take("w") == (A, 3)


def test_a_pair_is_compiled_again_only_where_many_of_it_wait():
    waiting = filled(*[A] * (ENOUGH_TO_COMPILE + 2))
    assert waiting.take("w") is not None
    assert waiting.take("x") is not None
    assert waiting.take("w") is not None
    assert waiting.take("y") is None
    assert waiting.take("x") is not None


def test_what_a_lost_worker_had_is_new_again():
    waiting = filled(A, A, B, C)
    assert waiting.take("w")[0] == A
    waiting.lost("w")
    assert {waiting.take(name)[0] for name in "xyz"} == {A, B, C}


def test_every_task_comes_out_once_whatever_the_workers_do():
    chance = random.Random(4)
    for _ in range(200):
        waiting = WaitingTasks()
        put, taken, workers = [], [], [0, 1, 2]
        for number in range(60):
            action = chance.random()
            if action < 0.5:
                pair = (chance.choice("pqr"), chance.choice("st"))
                waiting.put(pair, number)
                put.append(number)
            elif action < 0.9:
                task = waiting.take(chance.choice(workers))
                taken += [] if task is None else [task]
            else:
                lost = chance.choice(workers)
                waiting.lost(lost)
                workers[workers.index(lost)] = 100 + number
        assert len(waiting) == len(put) - len(taken)
        while waiting:
            for worker in workers:
                task = waiting.take(worker)
                taken += [] if task is None else [task]
        assert sorted(taken) == put


@pytest.mark.parametrize("pairs", [1, 40, None], ids=["one pair", "forty pairs", "every task a pair of its own"])
def test_the_work_of_handing_out_one_task_does_not_grow_with_their_number(pairs: int | None):
    assert lines_of_handing_out(pairs, 100_000) < 1.1 * lines_of_handing_out(pairs, 1_000)


def lines_of_handing_out(pairs: int | None, count: int) -> int:
    """Lines of Python that two workers' next ten tasks cost."""
    waiting = WaitingTasks()
    for number in range(count):
        kind = number % (pairs or count)
        waiting.put((f"problem {kind // 5}", f"solver {kind % 5}"), number)
    lines = 0

    def count_lines(*_: object) -> object:
        nonlocal lines
        lines += 1
        return count_lines

    before = sys.gettrace()
    sys.settrace(count_lines)
    try:
        for _ in range(10):
            waiting.take("w")
            waiting.take("x")
    finally:
        sys.settrace(before)
    return lines
