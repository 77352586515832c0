"""Timing pass: readings of the processor time of solves without intermediate output.

A reading is the processor time of one solve, taken alone on a core: it excludes what other processes take from that core,
and for a process of one thread it equals the wall time on an idle machine.
"""

from __future__ import annotations

import gc
import os
import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from hhtbench.campaign.run import WARM_UP, Phase, of_plugins, request_of, text_of, warm_up, without_output
from hhtbench.protocol.problem import Problem, Solver
from hhtbench.solution.request import Request

MIN_READING = 0.02  # shortest reading [s of solves]: far above the clock's resolution and other activity of the process
PATIENCE = 5.0  # times as much wall time, after which a reading of a solve that waits ends
LONG = 0.05  # s: longer solves vary little and need one reading only
DISTURBED = 1.2  # wall time over processor time above which something else ran on the core


def time_cell(problem: Problem, solver: Solver, asked: Mapping[str, Any], warm: bool, phase: Phase) -> dict[str, Any]:
    """Take one reading of a cell's time; the result holds ``note`` if a solve failed."""
    request = replace(without_output(problem, request_of(problem, asked)), max_seconds=None)  # it has kept its budget before
    if not warm:
        phase(WARM_UP)
        warm_up(problem, solver, request)
    phase("a timed solve")
    try:
        return reading(problem, solver, request)
    except of_plugins() as error:  # a plugin's or a user's: it costs this reading only
        return {"note": f"a timed solve raised {text_of(error)}"}


def reading(problem: Problem, solver: Solver, request: Request) -> dict[str, Any]:
    """Repeat the solve until ``MIN_READING`` seconds have passed and return the mean times of one solve [s]."""
    count, cpu, wall = 0, 0.0, 0.0
    gc.disable()
    try:
        begun, used = time.perf_counter(), time.process_time()
        while cpu < MIN_READING and wall < PATIENCE * MIN_READING:
            found = solver.solve(problem, request)
            if not found.success:
                return {"note": f"a timed solve ended with {found.status.label}: {found.message}"}
            count += 1
            wall, cpu = time.perf_counter() - begun, time.process_time() - used
    finally:
        gc.enable()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None  # mean load of the last minute; not every system has it
    return {"cpu_s": cpu / count, "wall_s": wall / count, "solves": count, "load": load}


def enough(readings: Sequence[Mapping[str, Any]]) -> bool:
    """True if no further reading is needed: one took at least ``LONG`` seconds or failed."""
    return any("cpu_s" not in reading or reading["cpu_s"] >= LONG for reading in readings)


def timing_of(readings: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Summarise all readings as a row's ``timing``; secondary values are those of the median reading."""
    failed = [reading for reading in readings if "cpu_s" not in reading]
    if failed:
        note = failed[0].get("note") or f"{failed[0].get('status')}: {failed[0].get('message')}"
        return {"repeats": 0, "note": note}
    times = [reading["cpu_s"] for reading in readings]
    median = readings[times.index(statistics.median_low(times))]
    return {
        "best_s": min(times),
        "median_s": median["cpu_s"],
        "rounds_s": times,
        "repeats": len(times),
        "solves": median["solves"],
        "wall_s": median["wall_s"],
        "load": median["load"],
        "disturbed": median["wall_s"] > DISTURBED * median["cpu_s"],
    }
