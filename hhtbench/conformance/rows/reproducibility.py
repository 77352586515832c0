"""Rows R1 to R7: reproducibility, concurrency, resources."""

from __future__ import annotations

import copy
import hashlib
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

import hhtbench as hb
from hhtbench.conformance.entry import Finding, Lane, tested
from hhtbench.conformance.rows.judging import Cases, apart, arrives, ends, judged, refuses, row, same, within
from hhtbench.conformance.scenes.rod import Q0, V0, Rod, plane
from hhtbench.conformance.subject import Declined, Subject

STATUS = hb.Status
ELSEWHERE = """
import sys
import hhtbench as hb
from hhtbench.conformance.rows.reproducibility import bits
print(bits(hb.solve(sys.argv[1], hb.load_solver(sys.argv[2]), rtol=1e-6)))
"""


def bits(found: hb.Solution) -> str:
    """Return a hash of all rows of a solution."""
    return hashlib.sha256(b"".join(getattr(found, x).tobytes() for x in ("t", "q", "v", "lam"))).hexdigest()


@row("R1", "the same solve twice, in two processes, with 1 and 4 BLAS threads", "bitwise equal", lane=Lane.slow)
def twice(subject: Subject) -> Cases:
    """Yield the cases of row R1: the same solve twice, in two processes, with 1 and 4 BLAS threads.

    Seven bodies of Andrews' squeezer, a hundredth of a second.
    """
    name = "andrews"
    here, again = (bits(subject.ask(hb.load_problem(name), rtol=1e-6, max_seconds=300.0)) for _ in range(2))
    yield "twice", "" if here == again else "other bits"
    for threads in ("1", "4"):
        environment = {**os.environ, "OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
        command = [sys.executable, "-c", ELSEWHERE, name, str(subject.spec)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        yield f"process with {threads} threads", "" if done.stdout.strip() == here else "other bits"


@row("R2", "q0 off by one ulp", "difference at most 100 tolerances")
def one_ulp(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row R2: q0 off by one ulp; both starts lie on the circle to rounding."""
    one, other = (subject.ask(Rod(), q0=q, **request) for q in (Q0, np.nextafter(Q0, 2.0)))
    yield "", within(apart(one, other) / request.get("rtol", 1e-6), 100, "difference over the tolerance:")


R3 = tested(
    "R3",
    "stop, save, load, go on",
    "equal to one run, bitwise",
    "tests/hht/test_checkpoint.py::test_a_run_that_was_checkpointed_and_resumed_goes_on_bit_by_bit",
)
COPIES: dict[str, Callable[[Any], Any]] = {"pickle": lambda x: pickle.loads(pickle.dumps(x)), "deepcopy": copy.deepcopy}


@row("R4", "pickle and deepcopy of solver and solution", "the same bits")
def copies(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row R4: pickle and deepcopy of solver and solution.

    Of a solution; of an integrator in mid-run: tests/hht/test_checkpoint.py.
    """
    found = subject.ask(Rod(), **request)
    for case, made in COPIES.items():
        other = made(found)
        yield f"solution by {case}", same(other, found) or ("" if other.counters == found.counters else "other counters")


@row("R5", "two solves in two threads; one solver in two threads", "the bits of one after the other; the second use refused")
def threads(subject: Subject) -> Cases:
    """Yield the cases of row R5: two solves in two threads, fifty rounds, and one solver in two threads."""

    def run(gravity: float) -> hb.Solution:
        return subject.ask(Rod(gravity=gravity), (0.0, 0.3), rtol=1e-4)

    given = (9.81, 3.0)
    alone = {gravity: run(gravity) for gravity in given}
    with ThreadPoolExecutor(2) as pool:
        faults = [same(found, alone[gravity]) for gravity, found in zip(given * 50, pool.map(run, given * 50), strict=True)]
    yield "fifty rounds", within(sum(map(bool, faults)), 0, "others of 100:")
    if subject.is_hht:
        yield "one object", _second_use(subject)


def _second_use(subject: Subject) -> str:
    inside, leave = threading.Event(), threading.Event()

    def force(t: float, q: Any, v: Any) -> Any:
        inside.set()
        leave.wait(30.0)
        return np.array([0.0, -9.81])

    hht = subject.hht(plane(force=force))
    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(hht.solve, (0.0, 0.1), Q0, V0, step=0.01)
        inside.wait(30.0)
        fault = refuses(lambda: hht.solve((0.0, 0.1), Q0, V0, step=0.01), "already solving", kinds=(RuntimeError,))
        leave.set()
        return fault or arrives(first.result(30.0))


@row("R6", "SIGINT in mid-solve, five times", "KeyboardInterrupt within 0.5 s, next solve right")
def interrupts(subject: Subject) -> Finding:
    """Yield the cases of row R6: SIGINT during a long solve, five times; the status ``interrupted`` counts as well."""
    if threading.current_thread() is not threading.main_thread():
        raise Declined("signals come to the main thread")
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    late: list[float] = []
    try:
        found = judged(_interrupts(subject, late), subject)
    finally:
        signal.signal(signal.SIGINT, before)
    return replace(found, measured=f"{found.measured}; latest after {max(late):.2g} s", in_time=max(late) < 0.5)


def _interrupts(subject: Subject, late: list[float]) -> Cases:
    right = subject.ask(Rod(), rtol=1e-5)
    for count in range(1, 6):
        sent: list[float] = []
        timer = threading.Timer(0.15, _interrupt, (sent,))
        timer.start()
        yield f"interrupt {count}", _interrupted(subject)
        late.append(time.perf_counter() - sent[0])
        timer.join()
        yield f"solve {count}", same(subject.ask(Rod(), rtol=1e-5), right)


def _interrupt(sent: list[float]) -> None:
    sent.append(time.perf_counter())
    os.kill(os.getpid(), signal.SIGINT)


def _interrupted(subject: Subject) -> str:
    try:
        found = subject.ask(Rod(), (0.0, 1e9), rtol=1e-8, max_seconds=60.0)
    except KeyboardInterrupt:
        return ""
    return ends(found, STATUS.interrupted)


@row("R7", "1000 failing and 1000 good solves of some 800 unknowns", "memory grows by less than 20 MB", lane=Lane.slow)
def memory(subject: Subject) -> Cases:
    """Yield the cases of row R7: 1000 failing and 1000 good solves of some 800 unknowns.

    After fifty of each; a chain of 160 links is 480 coordinates and 320 constraints.  A hundred of each in Python.

    That NaN in the work arrays before a run change no bit is held by tests/hht/test_memory.py.
    """
    rounds = 100 if subject.engine == "python" else 1000
    given = hb.load_problem("planar_chain(n_links=160)")
    request: dict[str, Any] = {"steps": 2} if subject.is_hht else {"rtol": 1e-2, "max_num_steps": 2}

    def run(scale: float) -> hb.Solution:
        return subject.ask(given.system, (0.0, 0.01), q0=given.q0 * scale, v0=given.v0, **request)

    first, before = run(1.0), 0
    for count in range(rounds + 50):
        before = _resident() if count == 50 else before
        good, bad = run(1.0), run(1.1)
    yield "memory", within((_resident() - before) / 2**20, 20, f"growth in {rounds} rounds [MB]:")
    yield "last", same(good, first)
    yield "start off the constraints", "what must fail succeeds" if bad.success else ""


def _resident() -> int:
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
