"""Worker process: receives one task at a time over a pipe and answers with JSON."""

from __future__ import annotations

import errno
import json
import os
import resource
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

from hhtbench.campaign.clock import time_cell
from hhtbench.campaign.reference import reference_of
from hhtbench.campaign.run import Phase, of_plugins, run_cell, status_of, text_of
from hhtbench.catalogue.registry import load_problem, load_solver, with_events
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem, Solver
from hhtbench.runtime.processes import opened
from hhtbench.solution.result import Status


def serve(descriptor: int, parent: int) -> None:
    """Answer tasks until the pipe closes or the process ``parent`` ends."""
    connection = opened(descriptor, parent)
    bench = Bench(lambda phase: connection.send_bytes(json.dumps({"phase": phase}).encode()))
    connection.send_bytes(json.dumps({"ready": True}).encode())
    while True:
        try:
            task = json.loads(connection.recv_bytes())
        except (EOFError, OSError):
            return
        answer = {"result": bench.do(task), "worn": _worn()}
        connection.send_bytes(json.dumps(answer, allow_nan=False).encode())


def _worn() -> bool:
    """True if so many files are open that a later task could fail."""
    try:
        return 2 * len(os.listdir("/proc/self/fd")) > resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    except OSError as error:
        return error.errno == errno.EMFILE


class Bench:
    """Cache of problems, solvers and compiled code between the tasks of one process."""

    def __init__(self, tell: Phase) -> None:
        self._tell = tell
        self._problems: dict[tuple[str, str | None], Problem] = {}
        self._solvers: dict[str, Solver] = {}
        self._warm: dict[tuple[str, str], dict[str, float]] = {}

    def do(self, task: dict[str, Any]) -> dict[str, Any]:
        """Run one task; exceptions of plugins and users' functions become a status or a note."""
        try:
            return self._do(task)
        except of_plugins() as error:  # it costs this task only
            if task["repeats"]:
                return {"note": text_of(error)}
            return {"status": status_of(error).label, "message": text_of(error)}

    def _do(self, task: dict[str, Any]) -> dict[str, Any]:
        self._tell("loading")
        names = task["problem"], task["solver"]
        try:
            certificate = task["request"].get("reference_file")
            if (names[0], certificate) not in self._problems:
                problem = load_problem(names[0])
                if certificate is not None:
                    problem = replace(problem, reference=reference_of(Path(certificate)))
                self._problems[names[0], certificate] = problem
            if names[1] not in self._solvers:
                self._solvers[names[1]] = load_solver(names[1])
        except (ProblemError, TypeError) as error:
            return {"status": Status.declined.label, "message": f"it cannot be loaded: {error}"}
        problem = self._problems[names[0], certificate]
        solver = with_events(self._solvers[names[1]], problem)
        warm = self._warm.setdefault(names, {})
        if task["repeats"]:
            return time_cell(problem, solver, task["request"], "s" in warm, self._tell)
        asked = {name: task["request"].get(name) for name in ("rtol", "atol", "step", "steps")}
        draw = zlib.crc32(json.dumps([*names, asked]).encode())  # depends on the cell's specs and request, not on sources
        return run_cell(problem, solver, task["request"], warm, self._tell, draw)
