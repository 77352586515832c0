"""The classical Runge-Kutta method on the underlying ODE, with constant steps."""

import numpy as np

import hhtbench as hb


class RK4:
    name = "acme_rk4"

    def accepts(self, problem, request):
        return None if request.fixed else "acme_rk4 takes prescribed steps: give step or steps"

    def solve(self, problem, request):
        equations = hb.Equations(problem, request)
        plan = hb.plan_steps(request, *problem.t_span)
        n, y = problem.q0.size, np.concatenate([problem.q0, problem.v0])
        times, states, stopped = [plan.t0], [y], None

        def rhs(t, y):
            return np.concatenate([y[n:], equations.acceleration(t, y[:n], y[n:])])

        try:
            for i in range(plan.count):
                t, h = times[-1], plan.length(i)
                k1 = rhs(t, y)
                k2 = rhs(t + h / 2, y + h / 2 * k1)
                k3 = rhs(t + h / 2, y + h / 2 * k2)
                k4 = rhs(t + h, y + h * k3)
                y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
                times.append(plan.end(i))
                states.append(y)
        except hb.Stop as stop:
            stopped = stop
        rows = np.array(states)
        return equations.solution(times, rows[:, :n], rows[:, n:], stopped=stopped)
