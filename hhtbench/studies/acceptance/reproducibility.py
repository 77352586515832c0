"""Reproducibility, concurrency, resources (rows R1 to R9)."""

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
from functools import partial
from typing import Any

import numpy as np

import hhtbench as hb
from hhtbench.studies.acceptance.asked import Asked
from hhtbench.studies.acceptance.callbacks import PLACES, raising, spoiled
from hhtbench.studies.acceptance.linear_algebra_events import WRONG_JACOBIANS, claiming
from hhtbench.studies.acceptance.rows import Finding, bounded, every, row
from hhtbench.studies.acceptance.scenes import Q0, V0, Rod, apart, ends, plane, problem, refuses, same
from hhtbench.testing.subject import Declined

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
    """After fifty of each; a chain of 160 links is 480 coordinates and 320 constraints.  A hundred of each in Python."""
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


@row(
    "R8",
    "200 random systems, options and faults",
    "no hang, no crash, no success that is not finite or off the constraints",
    long=True,
)
def random_cases(asked: Asked) -> Finding:
    """By seed; hypothesis and 10,000 cases are the fuzzing's."""
    random, faults = np.random.default_rng(11), {}
    for count in range(200):
        faults[f"case {count}"] = _random_case(asked, random)
    return every(faults)


def _random_case(asked: Asked, random: np.random.Generator) -> str:
    name, bad = str(random.choice(list(PLACES))), float(random.choice([np.nan, np.inf]))
    since, broken = random.uniform(0.0, 2.0), random.random() < 0.5
    system = spoiled(name, bad, lambda t, n: broken and t >= since)
    span = (0.0, float(10.0 ** random.uniform(-3, 0.3)))
    off = 10.0 ** random.uniform(-18, 0) * (random.random() < 0.3)
    way = dict(asked.ways())
    request = dict(way[str(random.choice(list(way)))])
    if "rtol" in request:
        request["rtol"] = float(10.0 ** random.uniform(-8, -2))
    began = time.perf_counter()
    found = asked.solve(problem(system, Q0 * (1 + off), V0, span), **request, max_seconds=5.0)
    if time.perf_counter() - began > 10.0:
        return "hangs"
    if not found.success:
        return ""
    level = float(np.abs((found.q**2).sum(axis=1) - 1).max())
    allowed = 2e-9 if asked.is_hht else 10 * request.get("rtol", 1e-6) + 3 * off  # of 2 |g|
    finite = all(np.isfinite(getattr(found, x)).all() for x in ("q", "v", "lam"))
    return "" if finite and level <= allowed and not (broken and since < span[1] - 0.01) else f"silent: level {level:.1e}"


def _always(t: float, count: int) -> bool:
    return True


def _system(**functions: Any) -> Callable[[], hb.NumpySystem]:
    return lambda: plane(**functions)


def _late(since: float, t: float, count: int) -> bool:
    return t >= since


RADII = _system(
    constraint=lambda t, q: np.array([q @ q - 1, q @ q - 1.21]) / 2, constraint_jacobian=lambda t, q: np.stack([q, q])
)
LONG = _system(force_jacobians=lambda t, q, v: (np.zeros((2, 3)), np.zeros((3, 2))))
LONG_CONSTRAINT = _system(constraint_jacobian=lambda t, q: np.zeros((3, 2)))
JUMP = _system(force=lambda t, q, v: np.array([0.0, -9.81 if t < 1 else -1e12]))
MASSLESS = hb.NumpySystem(mass_matrix=[1.0, 0.0], force=lambda t, q, v: np.array([0.0, -9.81]))
Fault = tuple[dict[str, Any], tuple[hb.Status, ...], tuple[str, ...]]


def injected() -> dict[str, Fault]:
    """What is solved, with the status and the words that name its cause."""
    off, nan, faults = (STATUS.inconsistent_initial,), (STATUS.nonfinite_callback,), dict[str, Fault]()
    for name in PLACES:
        for since in (-1.0, 1.0):
            system = spoiled(name, np.nan, partial(_late, since))
            faults[f"NaN in {name} from {since:g}"] = {"system": system}, nan, (name,)
    faults |= {
        "infinite Jacobian": ({"system": claiming(lambda x: x * np.nan)}, nan, ("force_jacobians",)),
        "start off g": ({"q0": Q0 * 1.05}, off, ("g[0]",)),
        "start off Gv": ({"v0": V0 + 0.2 * Q0}, off, ("g_q v",)),
        **{
            f"force Jacobian {case}": (
                {"system": claiming(change), "t_span": (0.0, 0.1)},
                (STATUS.success, STATUS.newton_failed),
                ("force_jac",),
            )
            for case, change in WRONG_JACOBIANS.items()
        },
        "NaN constraint Jacobian": ({"system": spoiled("constraint_jacobian", np.nan, _always)}, nan, ("constraint_jac",)),
        "shape of the force Jacobian": ({"system": LONG()}, (), ("force_jac",)),
        "shape of the constraint Jacobian": ({"system": LONG_CONSTRAINT()}, (), ("constraint_jac",)),
        "contradiction": ({"system": RADII()}, off, ("g[1]",)),
        "no mass": ({"system": MASSLESS}, (STATUS.singular_iteration_matrix,), ("mass",)),
        "steps": ({"max_num_steps": 3}, (STATUS.max_steps,), ("3 steps",)),
        "evaluations": ({"max_evaluations": 9}, (STATUS.evaluation_budget,), ("9 evaluations",)),
        "seconds": ({"max_seconds": 1e-9}, (STATUS.deadline,), ("seconds",)),
        "times": ({"t_span": (1e15, 1e15 + 1)}, (STATUS.time_resolution,), ("1000000000000000",)),
        "a huge jump": ({"system": JUMP()}, (STATUS.step_too_small, STATUS.success), ()),
        "exception": (
            {"system": raising(ZeroDivisionError("own"), "force", 1.0)},
            (STATUS.user_exception,),
            ("ZeroDivision",),
        ),
    }
    return faults


def _solved(asked: Asked, given: dict[str, Any]) -> hb.Solution:
    request = {"rtol": 1e-4, **given}
    place = (request.pop(name, value) for name, value in (("system", Rod()), ("q0", Q0), ("v0", V0), ("t_span", (0.0, 1.5))))
    return asked.solve(problem(*place), **request)


@row("R9", "every injected fault of C, O, P, J", "the reported cause is the injected one in at least 95 %")
def causes(asked: Asked) -> Finding:
    """The status, and the words of the message."""
    faults = {}
    for case, (given, statuses, words) in injected().items():
        try:
            found = _solved(asked, given)
            right = found.success and STATUS.success in statuses  # there is no cause to name
            faults[case] = ends(found, *statuses, words=() if right else words)
        except Declined:
            continue
        except ZeroDivisionError:
            faults[case] = "" if case == "exception" else "raises"
        except (ValueError, TypeError) as error:
            named = not statuses and all(word in str(error) for word in words)
            faults[case] = "" if named else f"raises {type(error).__name__}: {str(error)[:60]}"
    wrong = sum(map(bool, faults.values()))
    found = every(faults)
    return replace(found, holds=wrong <= 0.05 * len(faults))
