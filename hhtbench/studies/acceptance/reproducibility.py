"""Reproducibility, concurrency, resources (rows R1 to R7)."""

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
from typing import Any

import numpy as np

import hhtbench as hb
from hhtbench.conformance.subject import Declined
from hhtbench.studies.acceptance.asked import Asked
from hhtbench.studies.acceptance.rows import Finding, bounded, every, row
from hhtbench.studies.acceptance.scenes import Q0, V0, Rod, apart, ends, plane, problem, refuses, same

STATUS = hb.Status
ELSEWHERE = """
import hashlib, sys
import hhtbench as hb
found = hb.solve(sys.argv[1], hb.load_solver(sys.argv[2]), rtol=1e-6)
print(hashlib.sha256(b"".join(getattr(found, x).tobytes() for x in ("t", "q", "v", "lam"))).hexdigest())
"""


def _hash(found: hb.Solution) -> str:
    return hashlib.sha256(b"".join(getattr(found, x).tobytes() for x in ("t", "q", "v", "lam"))).hexdigest()


@row("R1", "the same solve twice, in two processes, with 1 and 4 BLAS threads", "bitwise equal", long=True)
def twice(asked: Asked) -> Finding:
    """Seven bodies of Andrews' squeezer, a hundredth of a second."""
    name = "andrews"
    spec = f"{asked.spec}(engine='{asked.engine}')" if asked.is_hht else asked.spec
    here = [_hash(asked.solve(hb.load_problem(name), rtol=1e-6, max_seconds=300.0)) for _ in range(2)]
    faults = {"twice": "" if here[0] == here[1] else "other bits"}
    for threads in ("1", "4"):
        environment = {**os.environ, "OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
        done = subprocess.run(
            [sys.executable, "-c", ELSEWHERE, name, spec], env=environment, capture_output=True, text=True, check=True
        )
        faults[f"process with {threads} threads"] = "" if done.stdout.strip() == here[0] else "other bits"
    return every(faults)


@row("R2", "q0 off by one ulp", "difference at most 100 tolerances")
def one_ulp(asked: Asked) -> Finding:
    """Both on the circle to rounding."""
    worst = 0.0
    for request in asked.ways().values():
        moved = np.nextafter(Q0, 2.0)
        one, other = (asked.solve(problem(Rod(), q, V0), **request) for q in (Q0, moved))
        worst = max(worst, apart(one, other) / request.get("rtol", 1e-6))
    return bounded(worst, 100.0, "tolerances:")


def _bits(hht: Any) -> bytes:
    return b"".join(np.asarray(x).tobytes() for x in (hht.state.t, hht.state.q, hht.state.v, hht.state.a, hht.state.lam))


def _stepped(hht: Any, count: int) -> list[bytes]:
    found = []
    for _ in range(count):
        if hht.step() is not STATUS.success:
            raise RuntimeError(hht.message)
        found.append(_bits(hht))
    return found


def _goes_on(asked: Asked, save: Callable[[Any], Any]) -> Finding:
    faults = {}
    for way, request in asked.ways().items():
        options, accuracy = {"alpha": request.get("alpha")}, {k: x for k, x in request.items() if k != "alpha"}
        whole, parts = (asked.hht(Rod(), **options) for _ in range(2))
        for hht in (whole, parts):
            hht.init_step(0.0, Q0, V0, **accuracy)
        right, found = _stepped(whole, 40), []
        for count in (0, 1, 2, 17, 20):
            found += _stepped(parts, count)
            parts = save(parts)
        faults[way or "adaptive"] = "" if found == right else "other bits"
    return every(faults)


@row("R3", "stop, save, load, go on", "equal to one run, bitwise")
def checkpoints(asked: Asked) -> Finding:
    """By checkpoint and resume in a new object, at five places."""

    def save(hht: Any) -> Any:
        other = asked.hht(Rod(), alpha=hht.options.alpha)
        other.resume(hht.checkpoint())
        return other

    return _goes_on(asked, save)


@row("R4", "pickle and deepcopy of solver and solution", "the same bits")
def copies(asked: Asked) -> Finding:
    """Of an integrator in mid-run; of a solution of every solver."""
    given, faults = problem(Rod(), Q0, V0), {}
    found = asked.solve(given, rtol=1e-5)
    for case, made in {"pickle": pickle.loads(pickle.dumps(found)), "deepcopy": copy.deepcopy(found)}.items():
        faults[f"solution by {case}"] = "" if same(made, found) and made.counters == found.counters else "other"
    if asked.is_hht:
        for case, save in {"pickle": lambda x: pickle.loads(pickle.dumps(x)), "deepcopy": copy.deepcopy}.items():
            gone = _goes_on(asked, save)
            faults[f"solver by {case}"] = "" if gone.holds else gone.measured
    return every(faults)


@row("R5", "two solves in two threads; one solver in two threads", "the bits of one after the other; the second use refused")
def threads(asked: Asked) -> Finding:
    """Fifty rounds."""
    given = [problem(Rod(), Q0, V0, (0.0, 0.3)), problem(Rod(gravity=3.0), Q0, V0, (0.0, 0.3))]
    run = lambda x: asked.solve(x, rtol=1e-4)  # noqa: E731
    alone = [run(x) for x in given]
    with ThreadPoolExecutor(2) as pool:
        rounds = [list(pool.map(run, given)) for _ in range(50)]
    different = sum(not same(x, y) for pair in rounds for x, y in zip(pair, alone, strict=True))
    faults = {"fifty rounds": "" if not different else f"{different} of 100 differ"}
    if asked.is_hht:
        faults["one object"] = _second_use(asked)
    return every(faults)


def _second_use(asked: Asked) -> str:
    inside, leave = threading.Event(), threading.Event()

    def force(t: float, q: Any, v: Any) -> Any:
        inside.set()
        leave.wait(30.0)
        return np.array([0.0, -9.81])

    hht = asked.hht(plane(force=force))
    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(hht.solve, (0.0, 0.1), Q0, V0, step=0.01)
        inside.wait(30.0)
        fault = refuses(lambda: hht.solve((0.0, 0.1), Q0, V0, step=0.01), "already solving", kinds=(RuntimeError,))
        leave.set()
        return fault or ends(first.result(30.0), STATUS.success)


@row("R6", "SIGINT in mid-solve, five times", "KeyboardInterrupt within 0.5 s, next solve right")
def interrupts(asked: Asked) -> Finding:
    """A solve of a minute; a status interrupted counts as well."""
    if threading.current_thread() is not threading.main_thread():
        raise Declined("signals come to the main thread")
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    right = asked.solve(problem(Rod(), Q0, V0), rtol=1e-5)
    late, faults = 0.0, {}
    try:
        for count in range(5):
            sent: list[float] = []
            timer = threading.Timer(0.15, _interrupt, (sent,))
            timer.start()
            faults[f"interrupt {count + 1}"] = _interrupted(asked)
            late = max(late, time.perf_counter() - sent[0])
            timer.join()
            faults[f"solve {count + 1}"] = (
                "" if same(asked.solve(problem(Rod(), Q0, V0), rtol=1e-5), right) else "other bits"
            )
    finally:
        signal.signal(signal.SIGINT, before)
    return every(faults, f"latest after {late:.2g} s", in_time=late < 0.5)


def _interrupt(sent: list[float]) -> None:
    sent.append(time.perf_counter())
    os.kill(os.getpid(), signal.SIGINT)


def _interrupted(asked: Asked) -> str:
    try:
        found = asked.solve(problem(Rod(), Q0, V0, (0.0, 1e9)), rtol=1e-8, max_seconds=60.0)
    except KeyboardInterrupt:
        return ""
    return ends(found, STATUS.interrupted)


@row("R7", "1000 failing and 1000 good solves of some 800 unknowns", "resident memory grows by less than 20 MB", long=True)
def memory(asked: Asked) -> Finding:
    """After fifty of each; a chain of 160 links is 480 coordinates and 320 constraints.  A hundred of each in Python.

    That NaN in the work arrays before a run change no bit is held by tests/hht/test_memory.py.
    """
    rounds = 100 if asked.engine == "python" else 1000
    given = hb.load_problem("planar_chain(n_links=160)")
    chain = problem(given.system, given.q0, given.v0, (0.0, 0.01))
    off = problem(given.system, given.q0 * 1.1, given.v0, (0.0, 0.01))
    request: dict[str, Any] = {"steps": 2} if asked.is_hht else {"rtol": 1e-2, "max_num_steps": 2}
    first, before = asked.solve(chain, **request), 0
    for count in range(rounds + 50):
        before = _resident() if count == 50 else before
        good, bad = asked.solve(chain, **request), asked.solve(off, **request)
    grown, equal = (_resident() - before) / 2**20, same(good, first)
    if bad.success:
        return Finding(measured="what must fail succeeds", holds=False)
    return Finding(
        measured=f"{grown:.1f} MB in {rounds} rounds, last result {'equal' if equal else 'another'}",
        holds=grown < 20 and equal,
    )


def _resident() -> int:
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
