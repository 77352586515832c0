from __future__ import annotations

import re

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench
from hhtbench import NumpySystem, Problem, ProblemError, Solution, Status, System, solve


class Declines:
    name = "declines"

    def accepts(self, problem, request):
        return "it never takes anything"

    def solve(self, problem, request):
        raise RuntimeError("must not be reached")


class Pendulum(System):
    def force(self, t, q, v):
        return jnp.array([0.0, -9.81])

    def constraint(self, t, q):
        return jnp.array([q @ q - 1.0])

    def velocity_constraint(self, t, q, v):
        return jnp.stack([v[0], v[1], v[0] + v[1]])


def _problem(system, **changes):
    values = {"name": "p", "system": system, "t_span": (0.0, 1.0), "q0": [1.0, 0.0], "v0": [0.0, 0.0]}
    return Problem(**{**values, **changes})


def _explodes(t, q, v=None):
    raise AssertionError("a declined problem is never called")


@pytest.mark.parametrize(
    ("problem", "m"),
    [
        (_problem(Pendulum(), lam_guess=[1.0]), 1),
        (_problem(NumpySystem(force=_explodes, constraint=_explodes)), 0),
    ],
)
def test_declined_problem_gives_no_rows_and_the_reason_and_is_not_called(problem, m):
    solution = solve(problem, Declines())
    assert solution.status is Status.declined
    assert not solution.success
    assert solution.message == "it never takes anything"
    assert solution.t.shape == (0,)
    assert [getattr(solution, name).shape for name in ("q", "v", "lam", "mu")] == [(0, 2), (0, 2), (0, m), (0, 0)]
    assert "it never takes anything" in repr(solution)


def test_solve_takes_specs_and_request_keywords(acme):
    solution = solve("acme_fall(n=3)", "acme_still", step=0.1)
    assert solution.success
    assert solution.q.shape == (2, 3)


def test_output_times_outside_the_interval_are_refused_before_the_solver_is_asked():  # S8
    with pytest.raises(ProblemError, match=r"t_eval must lie within \[0, 1\]"):
        solve(_problem(NumpySystem(force=_explodes)), Declines(), t_eval=[0.5, 2.0])
    with pytest.raises(ProblemError, match="sorted along the interval"):
        solve(_problem(NumpySystem(force=_explodes)), Declines(), t_eval=[0.5, 0.2])


def test_without_tolerances_and_steps_plain_accuracy_is_taken_and_said():
    told, asked = solve("simple_pendulum"), solve("simple_pendulum", rtol=1e-4)
    assert told.success
    assert told.q.tolist() == asked.q.tolist()
    assert told.message == f"{asked.message} No tolerance was given: rtol = 0.0001 was taken."
    problem = hhtbench.load_problem("simple_pendulum")
    itself, same = (
        hhtbench.HHT(problem.system).solve(problem.t_span, problem.q0, problem.v0, **given) for given in ({}, {"rtol": 1e-4})
    )
    assert itself.q.tolist() == same.q.tolist()
    assert itself.message == told.message
    declined = solve("simple_pendulum", "rattle")
    assert declined.status is Status.declined  # a solver of prescribed steps still asks for them
    assert "step" in declined.message


def test_the_integrator_and_its_events_are_names_of_the_package():
    from hhtbench.protocol.events import Event
    from solvers.hht import HHT

    assert (hhtbench.HHT, hhtbench.Event) == (HHT, Event)
    assert re.fullmatch(r"\d+\.\d+.*", hhtbench.__version__)


class Silent(Declines):
    """It stops at the start and gives no message."""

    def accepts(self, problem, request):
        return None

    def solve(self, problem, request):
        start = {"t": problem.t_span[:1], "q": [problem.q0], "v": [problem.v0], "lam": [[]], "mu": [[]]}
        arrays = {name: np.asarray(value, dtype=float) for name, value in start.items()}
        return Solution(**arrays, status=Status.newton_failed, message=None)


def test_a_solver_without_a_message_is_no_obstacle():
    found = solve(_problem(NumpySystem(force=lambda t, q, v: -q)), Silent())
    assert (found.status, found.message) == (Status.newton_failed, "No tolerance was given: rtol = 0.0001 was taken.")


@pytest.mark.parametrize(("given", "meant"), [("forces", "force"), ("M", "mass_matrix"), ("masses", "mass_matrix")])
def test_a_name_near_one_of_the_protocol_is_answered_with_that(given, meant):
    with pytest.raises(TypeError, match=rf"does not know {given}; .* Did you mean {meant}\?"):
        NumpySystem(**{given: lambda t, q, v: -q})
    with pytest.raises(TypeError, match="needs force"):
        NumpySystem(constraint=lambda t, q: q)
