"""Lagrange's equations by SymPy against the same physics written by hand."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
import sympy
from sympy.physics.mechanics import LagrangesMethod, Lagrangian, Particle, Point, ReferenceFrame, dynamicsymbols

import hhtbench as hb

TIME = dynamicsymbols._t
m1, m2, g, rope, c, lift = sympy.symbols("m1 m2 g rope c lift")
x, a, b = dynamicsymbols("x a b")
VALUES = {m1: 20.0, m2: 5.0, g: 9.81, rope: 4.0, c: 10.0, lift: 0.1}
OTHERS = {symbol: value for symbol, value in VALUES.items() if symbol is not c}


def crane(name=c) -> LagrangesMethod:
    """A trolley with a load on a rope that is drawn in, with a damper and a force in time."""
    frame, origin = ReferenceFrame("N"), Point("O")
    origin.set_vel(frame, 0)
    trolley, load = origin.locatenew("T", x * frame.x), origin.locatenew("P", a * frame.x + b * frame.y)
    trolley.set_vel(frame, x.diff() * frame.x)
    load.set_vel(frame, a.diff() * frame.x + b.diff() * frame.y)
    bodies = Particle("trolley", trolley, m1), Particle("load", load, m2)
    bodies[1].potential_energy = m2 * g * b
    push = (50 * sympy.sin(TIME) - name * x.diff()) * frame.x
    length = ((a - x) ** 2 + b**2 - (rope - lift * TIME) ** 2) / 2
    return LagrangesMethod(
        Lagrangian(frame, *bodies), [x, a, b], hol_coneqs=[length], forcelist=[(trolley, push)], frame=frame
    )


class Crane(hb.System):
    """The same by hand."""

    c: object = hb.parameter(10.0)

    def mass_matrix(self, t, q):
        return jnp.diag(jnp.array([20.0, 5.0, 5.0]))

    def force(self, t, q, v):
        return jnp.stack([50.0 * jnp.sin(t) - self.c * v[0], 0.0, -9.81 * 5.0])

    def constraint(self, t, q):
        return jnp.stack([((q[1] - q[0]) ** 2 + q[2] ** 2 - (4.0 - 0.1 * t) ** 2) / 2])


def solved(system, **changes):
    problem = hb.Problem(name="crane", system=system, t_span=(0, 2), q0=[0, 0, -4], v0=[0, 0, 0.1])
    return hb.solve(problem, step=0.01, **changes)


def test_a_crane_by_lagranges_equations_moves_as_the_one_by_hand():
    made, by_hand = solved(hb.from_sympy(crane(), VALUES)), solved(Crane())
    np.testing.assert_allclose(made.q, by_hand.q, rtol=0, atol=1e-11)
    np.testing.assert_allclose(made.lam, by_hand.lam, rtol=1e-9)


def test_its_symbols_are_parameters():
    system = hb.from_sympy(crane(), VALUES, name="Crane")
    changed = solved(replace(system, c=0.0))
    np.testing.assert_allclose(changed.q, solved(Crane(c=0.0)).q, rtol=0, atol=1e-11)
    assert (
        "Crane" in hb.describe(hb.Problem(name="p", system=system, t_span=(0, 1), q0=[0, 0, -4], v0=[0, 0, 0.1])).__repr__()
    )


def test_nonholonomic_constraints_hold_velocities():
    """A skate on an incline; Neimark and Fufaev's closed solution is a cycloid."""
    phi = dynamicsymbols("phi")
    q1, q2 = dynamicsymbols("q1 q2")
    mass, inertia, slope = sympy.symbols("mass inertia slope")
    kinetic = (mass * (q1.diff() ** 2 + q2.diff() ** 2) + inertia * phi.diff() ** 2) / 2
    edge = sympy.sin(phi) * q1.diff() - sympy.cos(phi) * q2.diff()
    method = LagrangesMethod(kinetic + mass * slope * q1, [q1, q2, phi], nonhol_coneqs=[edge])
    system = hb.from_sympy(method, {"mass": 1.0, "inertia": 1.0, "slope": 4.9})
    skate = hb.Problem(name="skate", system=system, t_span=(0, 4), q0=[0, 0, 0], v0=[0, 0, 2.0])
    assert hb.check(skate).passed
    found = hb.solve(skate, rtol=1e-7)
    w, t = 2.0, found.t
    np.testing.assert_allclose(found.q[:, 0], 4.9 * np.sin(w * t) ** 2 / (2 * w**2), atol=1e-5)
    np.testing.assert_allclose(found.q[:, 1], 4.9 * (w * t - np.sin(2 * w * t) / 2) / (2 * w**2), atol=1e-5)


@pytest.mark.parametrize(
    ("method", "values", "text"),
    [
        (crane, OTHERS, "values lacks c; it has g, lift, m1, m2, rope"),
        (crane, {**VALUES, "k": 1.0}, "values has k, which no equation has"),
        (crane, {**VALUES, m2: "five"}, r"values\[m2\] must be a real number"),
        (lambda: crane(sympy.Symbol("force")), {**OTHERS, "force": 1.0}, "'force' cannot be the name of a parameter"),
        (lambda: crane(dynamicsymbols("u")), OTHERS, r"force has u\(t\), which are neither coordinates"),
    ],
)
def test_wrong_use_is_refused_by_name(method, values, text):
    with pytest.raises((hb.ProblemError, TypeError), match=text):
        hb.from_sympy(method(), values)


def test_velocities_in_the_mass_and_in_holonomic_constraints_are_refused():
    quartic = LagrangesMethod(x.diff() ** 4 / 4 + x.diff() ** 2 / 2 - x**2 / 2, [x])
    with pytest.raises(hb.ProblemError, match="mass_matrix depends on velocities; a Lagrangian must be quadratic"):
        hb.from_sympy(quartic, {})
    held = LagrangesMethod((x.diff() ** 2 + a.diff() ** 2) / 2, [x, a], hol_coneqs=[a - x.diff()])
    with pytest.raises(
        hb.ProblemError, match="constraint depends on velocities; give what holds velocities as nonhol_coneqs"
    ):
        hb.from_sympy(held, {})


def test_symbols_of_one_name_and_other_objects_are_refused():
    k, same = sympy.Symbol("k"), sympy.Symbol("k", positive=True)
    with pytest.raises(hb.ProblemError, match="several symbols are called k"):
        hb.from_sympy(LagrangesMethod(k * x.diff() ** 2 / 2 - same * x**2, [x]), {"k": 1.0})
    with pytest.raises(TypeError, match=r"takes a .*LagrangesMethod; got int"):
        hb.from_sympy(3, {})
