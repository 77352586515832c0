"""Wall-clock limits of hostile cases (rows I2, C1, C2, J2 and R5 of the acceptance matrix), printed; 1 if one breaks.

Not a test: a loaded machine may not fail a build.  ``python -m tests.performance.hostile_limits``
"""

import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from hhtbench.protocol import NumpySystem
from hhtbench.result import Status
from solvers.hht import HHT
from tests.hht.scenes import ALPHAS, GRAVITY, Q0, SYSTEMS, V0, circle, circle_jacobian, pendulum, same_bits
from tests.hht.test_jacobians import claiming


def no_solution():
    """I2: no position satisfies the constraint."""
    for size in (1e-8, 1.0, 20.0, 1e12):
        system = NumpySystem(force=lambda t, q, v: np.zeros(2), constraint=lambda t, q: np.array([q @ q + 1.0]))
        solution = HHT(system, calc_initcond=True).solve((0.0, 1.0), size * Q0, V0, step=0.01)
        assert solution.status is Status.inconsistent_initial, solution.message


def undefined_from(time_of_fault):
    def force(t, q, v):
        return np.array([0.0, np.nan if t >= time_of_fault else -GRAVITY])

    return pendulum(force=force)


def undefined_at_the_start():
    """C1: NaN at t0 in the force, the constraint and its Jacobian."""
    faulty = {
        "constraint": lambda t, q: circle(t, q) * np.nan,
        "constraint_jacobian": lambda t, q: circle_jacobian(t, q) * np.inf,
    }
    for system in (undefined_from(0.0), *(pendulum(**{name: function}) for name, function in faulty.items())):
        assert HHT(system).solve((0.0, 1.0), Q0, V0, step=0.01).status is Status.nonfinite_callback


def undefined_in_mid_run():
    """C2: NaN from t = 1 on, output at the ends and at many times."""
    for alpha in ALPHAS:
        for output in ([0.0, 2.0], np.linspace(0.0, 2.0, 401)):
            solution = HHT(undefined_from(1.0), alpha=alpha).solve((0.0, 2.0), Q0, V0, step=0.01, t_eval=output)
            assert solution.status is Status.nonfinite_callback


def wrong_force_jacobian():
    """J2: the declared Jacobian of a stiff force has the wrong sign."""
    assert HHT(claiming(lambda x: -x)).solve((0.0, 0.1), Q0, V0, step=0.005).success


def two_threads():
    """R5: 50 rounds of two solvers in two threads."""

    def run(route):
        return HHT(SYSTEMS[route]).solve((0.0, 0.1), Q0, V0, step=0.01)

    serial = [run(route) for route in SYSTEMS]
    with ThreadPoolExecutor(2) as pool:
        for _ in range(50):
            assert all(same_bits(x, y) for x, y in zip(pool.map(run, SYSTEMS), serial, strict=True))


LIMITS = {  # seconds; the matrix gives the first three per case, here they hold for all cases together
    no_solution: 1.0,
    undefined_at_the_start: 1.0,
    undefined_in_mid_run: 2.0,
    wrong_force_jacobian: 5.0,
    two_threads: 10.0,
}


def main() -> int:
    broken = 0
    for case, limit in LIMITS.items():
        started = time.perf_counter()
        case()
        seconds = time.perf_counter() - started
        broken += seconds > limit
        verdict = "holds" if seconds <= limit else "BROKEN"
        sys.stdout.write(f"{verdict:>6}  {seconds:6.3f} s of {limit:g} s  {case.__doc__}\n")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
