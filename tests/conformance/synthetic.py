"""Synthetic solvers that mislead: no cell of a family may count them as right."""

from __future__ import annotations

import time

import jax
import numpy as np
from scipy.integrate import cumulative_trapezoid

import hhtbench as hb
from hhtbench.conformance.scenes.circles import FAST, FIRST, SECOND, SLOW, on_circle
from hhtbench.conformance.scenes.pendulum import PERIOD

SYNTHETIC = __file__  # that specs of these solvers name


class Straight:
    """Goes straight on, constraints or not, and says success."""

    name = "straight"

    def accepts(self, problem, request):
        return None

    def solve(self, problem, request):
        t = self.rows(problem, request)
        rows = np.size(problem.system.constraint(t[0], problem.q0)) if hasattr(problem.system, "constraint") else 0
        return said(t, *self.motion(problem, request, t), np.zeros((t.size, rows)))

    def rows(self, problem, request):
        return np.linspace(*problem.t_span, 5) if request.t_eval is None else np.asarray(request.t_eval)

    def motion(self, problem, request, t):
        """q and v."""
        return problem.q0 + np.outer(t - problem.t_span[0], problem.v0), np.tile(problem.v0, (t.size, 1))


def said(t, q, v, lam):
    return hb.Solution(t=t, q=q, v=v, lam=lam, mu=np.zeros((t.size, 0)), status=hb.Status.success, message="")


class Still(Straight):
    """Stays where it was let go."""

    def motion(self, problem, request, t):
        return np.tile(problem.q0, (t.size, 1)), np.zeros((t.size, problem.q0.size))


class Raising(Straight):
    """Raises where a status is expected."""

    def solve(self, problem, request):
        raise ArithmeticError("lost")


class Sleeping(Straight):
    """Looks at no clock."""

    def solve(self, problem, request):
        time.sleep(3600.0)


class Dying(Straight):
    """Takes its process along."""

    def solve(self, problem, request):
        import os

        os._exit(7)


class Exact(Straight):
    """The closed solution with its multipliers, but for what a child changes."""

    def solve(self, problem, request):
        t = self.rows(problem, request)
        return said(t, *self.motion(problem, request, t), np.array([problem.exact(float(s)).lam for s in t]))

    def motion(self, problem, request, t):
        known = [problem.exact(float(s)) for s in self.when(t)]
        return np.array([x.q for x in known]), np.array([x.v for x in known])

    def when(self, t):
        return t


class Ignoring(Exact):
    """Integrates the applied forces of the right motion and leaves out those of the constraints, which it knows by heart."""

    def motion(self, problem, request, t):
        q, v = super().motion(problem, request, t)
        jacobian = jax.jit(jax.jacfwd(lambda q: problem.system.constraint(0.0, q)))
        times = np.linspace(*problem.t_span, 201)
        known = [problem.exact(float(s)) for s in times]
        pull = np.array([np.asarray(jacobian(x.q)).T @ x.lam for x in known])
        faster = cumulative_trapezoid(pull, times, axis=0, initial=0.0)
        farther = cumulative_trapezoid(faster, times, axis=0, initial=0.0)
        added = [np.column_stack([np.interp(t, times, x) for x in of.T]) for of in (farther, faster)]
        return q + added[0], v + added[1]


class Powerless(Exact):
    """The right motion, and constraints that take up no force."""

    def solve(self, problem, request):
        found = super().solve(problem, request)
        return said(found.t, found.q, found.v, np.zeros_like(found.lam))


class Across(Exact):
    """Leaves the second of two constraints, slowly."""

    def motion(self, problem, request, t):
        q, v = super().motion(problem, request, t)
        return q + 0.05 * np.outer(t, SECOND), v + 0.05 * SECOND


class Shaking(Exact):
    """With a vibration across that has grown to a thousandth of the motion."""

    def motion(self, problem, request, t):
        q, v = super().motion(problem, request, t)
        return q + 1e-3 * np.outer(np.sin(40 * t), FAST), v


class OutOfPhase(Exact):
    """Half a period late."""

    def when(self, t):
        return t + PERIOD / 2


class Beside(Exact):
    """Right to 0.15 of the unit of length."""

    def motion(self, problem, request, t):
        q, v = super().motion(problem, request, t)
        return q + 0.15, v


class Deaf(Exact):
    """Goes on as if no force had jumped: the circle of the problem, and y = cos t on its arc."""

    def motion(self, problem, request, t):
        radius = float(problem.system.radius)
        known = [on_circle(np.cos(s), -np.sin(s), SLOW, FIRST, radius) for s in t]
        return [np.array(x) for x in zip(*known, strict=True)]


class Spoiled(Straight):
    """HHT, and what :meth:`spoil` adds."""

    def solve(self, problem, request):
        asked = {"rtol": request.rtol, "steps": request.steps, "step": request.step, "t_eval": request.t_eval}
        found = hb.solve(problem, "hht", **asked)
        return said(found.t, *self.spoil(problem, request, found), found.lam)


class FirstOrder(Spoiled):
    """An error as small as the step, where it should be as its square."""

    def spoil(self, problem, request, found):
        return found.q + 0.5 * (request.step or 0.0), found.v


class Growing(Spoiled):
    """What the start is off by grows exponentially."""

    def spoil(self, problem, request, found):
        off = float(problem.system.constraint(0.0, problem.q0)[0]) + float(problem.q0 @ problem.v0)
        normal = found.q / np.linalg.norm(found.q, axis=1, keepdims=True)
        return found.q + off * np.expm1(found.t - found.t[0])[:, None] * normal, found.v


class Drifting(Spoiled):
    """Leaves the constraints by little more than roundoff."""

    def spoil(self, problem, request, found):
        return found.q * (1.0 + 5e-12), found.v


class Losing(Spoiled):
    """A pendulum whose swings are lower by a thousandth of a radian at every row but the first."""

    def spoil(self, problem, request, found):
        angle = np.where(found.t > 0.0, -1e-3, 0.0) * np.sign(found.q[:, 0])
        c, s = np.cos(angle), np.sin(angle)
        x, y = found.q.T
        return np.column_stack([c * x - s * y, s * x + c * y]), found.v
