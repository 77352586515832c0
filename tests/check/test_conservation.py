"""Energy, power and invariants are checked along the known motion."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.checks.problem import check
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.system import NumpySystem, System, parameter


class Slide(System):
    """A mass that a damper slows down on a guide: x = x(t) along y = 0."""

    c: object = parameter(0.5, doc="[N s/m]")

    def force(self, t, q, v):
        return jnp.stack([-self.c * v[0], -9.81])

    def constraint(self, t, q):
        return q[1:]

    def energy(self, t, q, v):
        return v @ v / 2 + 9.81 * q[1]


class Fed(Slide):
    def power(self, t, q, v, lam, mu):
        return -self.c * v[0] ** 2


class Lifted(Slide):
    """The guide rises: its force does work, lam . g_t by the sign of the default reaction."""

    def constraint(self, t, q):
        return q[1:] - 2.0 * t

    def power(self, t, q, v, lam, mu):
        return -self.c * v[0] ** 2 - 2.0 * lam[0]


def exact(rise, t):
    decay = np.exp(-0.5 * t)
    q, v = np.array([2 * (1 - decay), rise * t]), np.array([decay, rise])
    return Motion(q=q, v=v, lam=np.array([-9.81]), mu=np.zeros(0))


def slide(system, rise=0.0, **changes):
    start = exact(rise, 0.0)
    made = Problem(name="slide", system=system, t_span=(0.0, 2.0), q0=start.q, v0=start.v, exact=lambda t: exact(rise, t))
    return replace(made, **changes)


def verdict(problem, row_id):
    return next((row.passed for row in check(problem).rows if row.id == row_id), "no such row")


def test_energy_that_a_damper_takes_must_be_declared_as_power():
    assert verdict(slide(Fed()), "energy/balance") is True
    assert verdict(slide(Slide()), "energy/balance") is False
    assert verdict(slide(Slide()), "energy/conserved") is False
    assert verdict(slide(Slide(c=0.0), exact=None), "energy/balance") is True


def test_a_moving_constraint_feeds_energy_through_its_multiplier():
    assert verdict(slide(Lifted(), 2.0), "energy/balance") is True
    assert verdict(slide(Fed(), 2.0, exact=None, v0=np.array([1.0, 0.0])), "energy/balance") is True


@pytest.mark.parametrize("factor", [1.0, 1.01])
def test_power_off_by_a_percent_is_found_on_plain_callables(factor):
    functions = {
        "force": lambda t, q, v: np.array([-0.5 * v[0], -9.81]),
        "constraint": lambda t, q: q[1:],
        "energy": lambda t, q, v: float(v @ v / 2 + 9.81 * q[1]),
        "power": lambda t, q, v, lam, mu: -0.5 * factor * v[0] ** 2,
    }
    assert verdict(slide(NumpySystem(**functions)), "energy/balance") is (factor == 1.0)


def test_an_invariant_that_the_closed_solution_changes_is_named():
    class Wrong(Fed):
        def invariants(self, t, q, v):
            return {"height": q[1], "momentum": v[0]}

    row = next(row for row in check(slide(Wrong())).rows if row.id == "energy/conserved")
    assert row.passed is False
    assert "momentum" in row.measured


def test_the_reference_may_change_energy_by_its_error_bars():
    def reference(error):
        t = np.linspace(0, 2, 5)
        q, v = (np.array([getattr(Motion(q=[s, 0.0], v=[1.0 + error * s, 0.0], lam=[], mu=[]), k) for s in t]) for k in "qv")
        bars = {"q": np.full(5, 1e-9), "v": np.full(5, 1e-9)}
        return {"t": t, "q": q, "v": v, "bars": bars, "digits": 9}

    for error, passed in ((1e-9, True), (1e-3, False)):
        problem = slide(Slide(c=0.0), exact=None, reference=reference(error))
        assert verdict(problem, "energy/conserved") is passed


def test_a_wrong_energy_is_found_where_constraints_are_redundant_too():
    class Twice(Slide):
        def constraint(self, t, q):
            return jnp.stack([q[1], 2 * q[1]])

    class Wrong(Twice):
        def energy(self, t, q, v):
            return 17 * v @ v + 3 * q[0]

    both = {"tags": ("redundant",), "exact": None, "v0": np.array([1.0, 0.0])}
    assert verdict(slide(Twice(c=0.0), **both), "energy/balance") is True
    assert verdict(slide(Wrong(c=0.0), **both), "energy/balance") is False


@pytest.mark.parametrize(("faster", "holds"), [(0.0, True), (1e-4, False)])
def test_a_reference_of_ones_own_needs_no_error_bars(faster, holds):
    class Free(System):
        def force(self, t, q, v):
            return 0 * q

        def energy(self, t, q, v):
            return v @ v / 2

    known = {"t": np.array([0.0, 1.0]), "q": np.array([[0.0], [1.0]]), "v": np.array([[1.0], [1.0 + faster]]), "digits": 9}
    free = Problem(name="free", system=Free(), t_span=(0.0, 1.0), q0=[0.0], v0=[1.0], reference=known)
    (row,) = [row for row in check(free).rows if row.id == "energy/conserved"]
    assert row.passed is holds
