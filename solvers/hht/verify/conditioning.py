"""The condition of Newton's matrix as it is scaled, (H13): flat over steps of 1e-2 to 1e-7 s."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhtbench import load_problem
from hhtbench.arguments import Matrix
from hhtbench.evidence import Row
from hhtbench.lowering import compile_function
from solvers.hht.equations.discretise import unpack_matrix
from solvers.hht.equations.methods import equations_of
from solvers.hht.solver import HHT
from solvers.hht.verify.measure import guesses, step_by_hand
from solvers.hht.verify.study import Method, below_row, named, shown_row
from solvers.kernel import memory as mem

LENGTHS = tuple(10.0**-k for k in range(2, 8))  # [s]
FLAT = 1.05  # largest over least: h times rates of the motion, 0.015 measured at most
JUDGED = ("jay_negrut_pendulum", "jay_negrut_test1", "rolling_disk3d_steady", "knife_edge")
SHOWN = ("stiff_spring_pendulum(stiffness=1e6)",)  # h w from 10 to 1e-4: force rows hold (h w)^2, S of section 10
CONDITIONED: tuple[Method, ...] = ({"alpha": 0.0}, {"alpha": -0.3}, {"alpha": -0.05, "b": 1.0})


def newton_matrix(name: str, h: float, **method: Any) -> Matrix:
    """That of the first step of ``h`` [s], (size, size), where it was made last."""
    p = load_problem(name)
    hht = HHT(p.system, **method)
    hht.init_step(p.t_span[0], p.q0, p.v0, step=h, **guesses(p))
    step_by_hand(name, hht)
    engine: Any = hht._engine
    made, section = engine.functions, engine.loops.section
    slot = int(section(mem.NUMBER)[mem.FACTOR])
    at = np.split(section(mem.MADE_AT + slot), [made.layout.size])
    function = equations_of(made.method).residual_and_matrix
    packed = compile_function(function, made.dynamics, made.method, made.layout)(*at)
    return np.asarray(unpack_matrix(made.layout, packed)[1][: made.layout.size])


def conditions(name: str, method: Method) -> list[Row]:
    """Largest over least condition, and all of them."""
    found = [float(np.linalg.cond(newton_matrix(name, h, **method))) for h in LENGTHS]
    id, claim = f"condition/{name}", f"{named(method)}: condition of Newton's matrix, h = 1e-2 to 1e-7 s"
    shown = shown_row(id, claim, {f"h = {h:g}": x for h, x in zip(LENGTHS, found, strict=True)})
    if name not in JUDGED:
        return [shown]
    return [below_row(id, f"{claim}, largest over least", max(found) / min(found), FLAT), shown]


CONDITIONS = tuple((conditions, name, method) for name in (*JUDGED, *SHOWN) for method in CONDITIONED)
