"""A distribution from outside: a falling weight, and solvers whose price of an error is known."""

from __future__ import annotations

PROBLEM = """\
    '''A weight that falls: y = 1 - g t^2 / 2.'''
    import numpy as np
    from hhtbench.protocol.problem import Motion, Problem
    from hhtbench.protocol.system import NumpySystem

    G = 9.81

    def exact(t):
        return Motion(np.array([1 - G * t**2 / 2]), np.array([-G * t]), np.zeros(0), np.zeros(0))

    def problem(t_end=1.0):
        system = NumpySystem(force=lambda t, q, v: 0 * q - G)
        return Problem(name="fall", system=system, t_span=(0.0, t_end), q0=[1.0], v0=[0.0], exact=exact)
"""

SOLVER = """\
    '''The exact fall with an error of rtol, for ``price * rtol ** (-1 / order)`` evaluations; it fails as it is told.'''
    import ctypes
    import numpy as np
    from hhtbench import Counters, Solution, Status

    class Priced:
        name = "priced"

        def __init__(self, price=10.0, order=4.0, does="good"):
            self.price, self.order, self.does = price, order, does

        def accepts(self, problem, request):
            if self.does == "decline":
                return "it takes no weights"
            return None if request.rtol is not None else "it takes tolerances only"

        def warm_up(self, problem, request):
            pass

        def solve(self, problem, request):
            if self.does == "crash":
                ctypes.string_at(0)
            if self.does == "fail":
                raise ValueError("no weight falls here")
            t = request.t_eval if request.t_eval is not None else np.linspace(*problem.t_span, 5)
            rows = [problem.exact(float(time)) for time in t]
            q, v = np.array([row.q for row in rows]) + request.rtol, np.array([row.v for row in rows])
            none = np.zeros((t.size, 0))
            spent = Counters(steps_accepted=4, residual_evaluations=round(self.price * request.rtol ** (-1 / self.order)))
            return Solution(t=t, q=q, v=v, lam=none, mu=none, status=Status.success, message="there", counters=spent)
"""

FILES = {"priced/__init__.py": "", "priced/fall.py": PROBLEM, "priced/solver.py": SOLVER}
GROUPS = {
    "hhtbench.problems": {"fall": "priced.fall:problem"},
    "hhtbench.solvers": {"priced": "priced.solver:Priced"},
}
