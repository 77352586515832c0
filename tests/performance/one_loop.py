"""Figures of the one loop over steps: modules behind a step, callbacks of a NumPy system, the command line.

``python -m tests.performance.one_loop`` prints them beside their limits and exits with 1 where one is broken;
``--against FOLDER`` compares the time of steps with another checkout that has its own ``.venv``, in pairs.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

from hhtbench import load_problem
from hhtbench.protocol.system import NumpySystem
from solvers.hht import HHT

ROOT = Path(__file__).parents[2]
ROOMS = ROOT / "solvers/hht", ROOT / "hhtbench/lowering"
PAIRS = 5
ROUNDS = 15
TIMES = """
import json, time, numpy as np
from hhtbench import load_problem
from solvers.hht import HHT
found = {}
for name, span, how in (
    ("jay_negrut_pendulum", 20.0, {"step": 1e-3}), ("jay_negrut_pendulum", 20.0, {"rtol": 1e-6}),
    ("andrews", 0.05, {"step": 1e-5}), ("andrews", 0.05, {"rtol": 1e-5}),
):
    p = load_problem(name)
    hht, (t0, _) = HHT(p.system, alpha=-0.3), p.t_span
    def run(span):
        began, ends = time.process_time(), (t0, t0 + span)
        s = hht.solve(ends, p.q0, p.v0, lam_guess=p.lam_guess, t_eval=np.array(ends), **how)
        return time.process_time() - began, s.counters.steps_accepted
    run(span / 10)
    each = []
    for _ in range(5):
        (long, many), (short, few) = run(span), run(span / 10)
        each.append(1e6 * (long - short) / (many - few))
    found[f"{name}, {', '.join(f'{k}={v:g}' for k, v in how.items())}"] = float(np.median(each))
print(json.dumps(found))
"""


def modules_behind_a_step() -> int:
    """Files of the integrator and the lowering that run in a controlled step of the pendulum, made by plain Python."""
    problem, files = load_problem("jay_negrut_pendulum"), set[str]()
    hht = HHT(problem.system, engine="python")
    hht.init_step(0.0, problem.q0, problem.v0, rtol=1e-4)
    hht.step()
    sys.setprofile(lambda frame, *_: files.add(frame.f_code.co_filename))
    hht.step()
    sys.setprofile(None)
    return sum(any(Path(file).is_relative_to(room) for room in ROOMS) for file in files)


def callbacks() -> list[tuple[str, float, float]]:
    """Rows of a NumPy pendulum with declared Jacobians: callbacks and microseconds of a step, with their limits."""
    q, v, count = np.array([1.0, 0.0]), np.zeros(2), Counter[str]()
    functions = {
        "force": lambda t, q, v: np.array([0.0, -9.81]),
        "force_jacobians": lambda t, q, v: (np.zeros((2, 2)), np.zeros((2, 2))),
        "constraint": lambda t, q: np.array([(q @ q - 1.0) / 2.0]),
        "constraint_jacobian": lambda t, q: q[None, :].copy(),
        "reaction": lambda t, q, lam: -lam[0] * q,
        "reaction_jacobians": lambda t, q, lam: (-lam[0] * np.eye(2), -q[:, None]),
        "constraint_time_derivative": lambda t, q: np.zeros(1),
    }
    arguments = {
        name: (0.0, q, v[:1] if "reaction" in name else v)[: f.__code__.co_argcount] for name, f in functions.items()
    }

    def own(name: str) -> float:
        return timed(functions[name], *arguments[name], repeat=1000)

    def counted(name, function):
        def call(*arguments):
            count[name] += 1
            return function(*arguments)

        return call

    plain = HHT(NumpySystem(**functions))
    counting = HHT(NumpySystem(**{name: counted(name, function) for name, function in functions.items()}))
    rows = []
    for name, how in {"constant": {"step": 1e-3}, "controlled": {"rtol": 1e-6}}.items():
        calls = Counter[str]()
        for sign, span in ((-1, 0.2), (1, 2.0)):
            count.clear()
            steps = counting.solve((0.0, span), q, v, t_eval=[0.0, span], **how).counters.steps_accepted
            calls.update({called: sign * number for called, number in count.items()} | {"steps": sign * steps})
        made = calls.pop("steps")
        fastest = dict.fromkeys([*calls, 0.2, 2.0], np.inf)  # in turn: the processor's pace changes by half within seconds
        for _ in range(ROUNDS):
            found = {called: own(called) for called in calls}
            found |= {end: timed(plain.solve, (0.0, end), q, v, t_eval=[0.0, end], repeat=1, **how) for end in (0.2, 2.0)}
            fastest = {key: min(fastest[key], value) for key, value in found.items()}
        limit = sum(number * (1.5 + fastest[called]) for called, number in calls.items()) / made + 20.0
        rows.append((f"callbacks of a NumPy pendulum's step, {name}", calls.total() / made, 30.0))
        rows.append((f"its time [us], {name}", (fastest[2.0] - fastest[0.2]) / made, limit))
    return rows


def timed(function, *arguments, repeat: int = 10_000, **options) -> float:
    """Microseconds of a call."""
    began = time.process_time()
    for _ in range(repeat):
        function(*arguments, **options)
    return 1e6 * (time.process_time() - began) / repeat


def in_new_process(code: str, folder: Path = ROOT) -> object:
    """What ``code`` prints as JSON."""
    made = subprocess.run(
        [folder / ".venv/bin/python", "-c", code],
        cwd=folder,
        capture_output=True,
        check=True,
    )
    return json.loads(made.stdout)


def command_line(*arguments: str) -> float:
    """Seconds of processor time of ``hhtbench`` with ``arguments``."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([ROOT / ".venv/bin/hhtbench", *arguments], capture_output=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> int:
    """Print the table; 1 where a limit is broken."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--against", type=Path)
    against = parser.parse_args().against
    rows = [("modules behind a step", modules_behind_a_step(), 20.0)]
    rows += callbacks()
    rows += [
        (f"hhtbench {word} [s of processor time]", min(command_line(word) for _ in range(3)), 0.4)
        for word in ("--help", "list")
    ]
    if against is not None:
        pairs = [(in_new_process(TIMES), in_new_process(TIMES, against)) for _ in range(PAIRS)]
        rows += [
            (f"{name}: time over that of {against}", float(np.median([a[name] / b[name] for a, b in pairs])), 1.10)
            for name in pairs[0][0]
        ]
    for name, value, limit in rows:
        sys.stdout.write(f"{name:75} {value:10.3g}  limit {limit:8.3g}  {'' if value <= limit else 'BROKEN'}\n")
    return int(any(value > limit for _, value, limit in rows))


if __name__ == "__main__":
    raise SystemExit(main())
