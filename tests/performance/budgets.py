"""How well ``max_seconds`` holds: every solver on four scenes, cold and warm, with few and many output rows; 1 if not.

A budget may be overrun by a fifth and 0.2 s, and by the one trace or compilation that the status names.  One
process with empty caches each; half an hour.  ``python -m tests.performance.budgets [--quick]``
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.protocol.system import NumpySystem
from hhtbench.solution.request import make_request

SOLVERS = (
    "hht",
    "hht(engine=python)",
    "ida",
    "ida(form=index1)",
    "cvode",
    "scipy(method=Radau)",
    "scipy(method=DOP853)",
    "diffrax(method=Tsit5)",
    "diffrax(method=Kvaerno5)",
    "projected",
    "collocation",
)
BUDGETS = (0.5, 1.0, 5.0)  # [s]
SHARE, EXTRA = 1.2, 0.2  # of a budget, and [s]: what a solve may take
ROWS = 20_000  # of many
SPAN = 1e4  # [s]: no solver arrives at the tolerance RTOL in the largest budget
RTOL = 1e-9
PREPARING = re.compile(r", while .*?, (?P<seconds>[\d.e+-]+) s that cannot be interrupted")


class Net(hb.System):
    """A net of 4 x 5 masses in space that hangs at one corner: 60 coordinates, 31 rods."""

    def force(self, t, q, v):
        return jnp.zeros((20, 3)).at[:, 2].set(-9.81).ravel() - 0.1 * v

    def constraint(self, t, q):
        x = q.reshape(4, 5, 3)
        rods = jnp.concatenate([(x[:, 1:] - x[:, :-1]).reshape(-1, 3), (x[1:] - x[:-1]).reshape(-1, 3)])
        return jnp.concatenate([(jnp.sum(rods**2, axis=1) - 1) / 2, x[0, 0]])


def net() -> hb.Problem:
    """Flat at the start."""
    q0 = np.array([[[j, i, 0.0] for j in range(5)] for i in range(4)], dtype=float).ravel()
    return hb.Problem(name="net", system=Net(), t_span=(0, SPAN), q0=q0, v0=np.zeros(60))


def slow_functions() -> hb.Problem:
    """60 coordinates in plain Python, without a derivative."""
    ends = np.arange(0, 60, 3)
    system = NumpySystem(
        force=lambda t, q, v: np.tile([0.0, 0.0, -9.81], 20) - 0.1 * v,
        constraint=lambda t, q: np.array([(sum(float(x) ** 2 for x in q[i : i + 3]) - 1) / 2 for i in ends]),
    )
    return hb.Problem(name="slow", system=system, t_span=(0, SPAN), q0=np.tile([1.0, 0.0, 0.0], 20), v0=np.zeros(60))


SCENES = {
    "numpy": slow_functions,
    "pendulum": lambda: hb.load_problem("simple_pendulum"),
    "andrews": lambda: hb.load_problem("andrews"),
    "net": net,
    "chain": lambda: hb.load_problem("planar_chain(n_links=32)"),
}


def one_process(scene: str, solver: str, budget: float) -> None:
    """Cold with many rows, then warm with two and with many: a JSON line for each."""
    problem = replace(SCENES[scene](), t_span=(0.0, SPAN))
    many = np.linspace(0.0, 10.0, ROWS)
    accurate, fine = {"rtol": RTOL}, {"step": 1e-6}
    runs = [("cold", many, accurate), ("warm", None, accurate), ("warm", many, accurate)]
    for start, rows, how in [*runs, ("steps", None, fine)] if solver.startswith("hht") else runs:
        if start == "warm" and rows is None:
            hb.load_solver(solver).warm_up(problem, make_request(rtol=RTOL, t_eval=many))
            hb.load_solver(solver).warm_up(problem, make_request(rtol=RTOL))
        times = None if rows is None else rows[: int(ROWS * budget)]
        began = time.perf_counter()
        solution = hb.solve(problem, solver, **how, max_seconds=budget, t_eval=times)
        wall = time.perf_counter() - began
        found = PREPARING.search(solution.message)
        preparing = float(found["seconds"]) if found else 0.0
        line = {"start": start, "rows": 0 if times is None else times.size, "wall": wall, "preparing": preparing}
        line |= {"status": solution.status.label, "message": solution.message}
        sys.stdout.write(json.dumps(line) + "\n")


def measure(scene: str, solver: str, budget: float) -> list[dict]:
    """The lines of one process with empty caches."""
    with tempfile.TemporaryDirectory() as folder:
        own = {"HHTBENCH_CACHE": folder, "JAX_COMPILATION_CACHE_DIR": f"{folder}/xla", "OMP_NUM_THREADS": "1"}
        command = [sys.executable, "-m", "tests.performance.budgets", scene, solver, str(budget)]
        done = subprocess.run(command, env=os.environ | own, capture_output=True, text=True, check=False)
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    return lines or [
        {"start": "-", "rows": 0, "wall": np.inf, "preparing": 0.0, "status": "raised", "message": done.stderr[-300:]}
    ]


def main(quick: bool) -> int:
    """The table; the number of broken budgets is the exit code's reason."""
    broken = 0
    for scene in SCENES:
        for solver in SOLVERS[: 3 if quick else None]:
            for budget in BUDGETS[: 1 if quick else None]:
                for line in measure(scene, solver, budget):
                    allowed = SHARE * budget + EXTRA + line["preparing"]
                    holds = line["wall"] <= allowed
                    broken += not holds
                    text = f"{scene:9}{solver:27}{budget:4g} s {line['start']:5}{line['rows']:7} rows {line['wall']:7.2f} s"
                    text += f" of {allowed:6.2f} s  {line['status']}{'' if holds else '  BROKEN ' + line['message']}"
                    sys.stdout.write(text + "\n")
                    sys.stdout.flush()
    sys.stdout.write(f"{broken} budgets broken\n")
    return int(broken > 0)


if __name__ == "__main__":
    if len(sys.argv) == 4:
        one_process(sys.argv[1], sys.argv[2], float(sys.argv[3]))
    else:
        sys.exit(main("--quick" in sys.argv))
