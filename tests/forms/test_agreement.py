"""Every form describes the same motion, on every registered problem and on small systems with every kind of constraint."""

from functools import cache

import numpy as np
import pytest

import hhtbench
from hhtbench.lowering import augment, derive
from solvers.forms import make_form
from tests.forms.scenes import LINEAR_NUMPY, C, Linear, Moment, Together, moment_of
from tests.lowering.systems import (
    MASSLESS_NUMPY,
    RICH_NUMPY,
    SPRINGS_NUMPY,
    Dragging,
    MasslessWheel,
    Pendulum,
    Rich,
    rich_force,
    rich_mass,
    rich_reaction,
)

pytestmark = pytest.mark.usefixtures("quick_xla")

Q3, V3 = np.array([0.6, 0.8, 0.48]), np.array([0.8, -0.6, 0.28])
LAM = np.array([0.5])  # picks the root of the quadratic reaction
SMALL = {
    "linear": (Linear(), Q3, V3, None),
    "rich": (Rich(), Q3, V3, LAM),
    "massless_wheel": (MasslessWheel(), Q3, V3, None),
    "pendulum": (Pendulum(), Q3[:2], V3[:2], None),
    "linear_numpy": (LINEAR_NUMPY, Q3, V3, None),
    "rich_numpy": (RICH_NUMPY, Q3, V3, LAM),
    "massless_numpy": (MASSLESS_NUMPY, Q3, V3, None),  # its mass augmented, hence regular
    "dragging": (Dragging(), Q3[:2], V3[:2], None),
    "springs_numpy": (SPRINGS_NUMPY, Q3[:2], V3[:2], None),
}
TOO_SLOW = "flyball_governor"  # bodies in space as well: `make validate` moves it by every form
SCENES = [name for name in (*hhtbench.list_problems(), *SMALL) if name != TOO_SLOW]
SMALLER = {"fekete": "fekete(n_points=6)"}  # the same equations, in a tenth of the time
SLOW = "bricard"  # bodies in space, as two others are: their Jacobian compiles for half a minute
COMPILED = [name for name in SCENES if not name.endswith("_numpy")]
DIFFERENCES = 1e-7  # of a NumPy system's undeclared derivatives where they enter the equations
NEWTON = 1e-4  # the same where they only serve Newton's matrix


@cache
def scene(name):
    """A consistent random state of the scene and all its forms."""
    if name in hhtbench.list_problems():
        moment = moment_of(hhtbench.load_problem(SMALLER.get(name, name)))
        return moment, Together(moment.dynamics)
    system, q, v, lam = SMALL[name]
    dynamics = derive(system, 0.2, q, v)
    moment = Moment(dynamics, 0.2, q, v, lam)
    return moment, Together(augment(dynamics, 0.2, q) if name == "massless_numpy" else dynamics)


def size_of_forces(moment):
    """The largest force in the equations of motion: what an imbalance is compared with."""
    mass = np.abs(np.asarray(moment.dynamics.mass(moment.t, moment.q)))
    force = np.asarray(moment.dynamics.force(moment.t, moment.q, moment.v))
    return max(1.0, (mass @ np.abs(moment.vdot)).max(), np.abs(force).max(), np.abs(moment.vdot).max())


@pytest.mark.parametrize("name", SCENES)
def test_residual_vanishes_on_the_motion(name):
    """With accelerations and multipliers of the KKT level, which knows nothing of forms; eta = 0."""
    moment, together = scene(name)
    found = together.residual(moment.t, *together.start(*moment.packed))
    bound = size_of_forces(moment) * (DIFFERENCES if name not in COMPILED else 1e-11)
    for form, residual in found.items():
        assert np.abs(residual).max() < bound, form


def levels_by_hand(t, q, v, a):
    """g, its first and second time derivative, k and its first, of the rich systems along q' = v, v' = a."""
    wave, rate = 0.2 * np.sin(3 * t), 0.6 * np.cos(3 * t)
    g = q[0] ** 2 + q[1] + 0.3 * np.sin(q[2]) - wave * q[0]
    g1 = 2 * q[0] * v[0] + v[1] + 0.3 * np.cos(q[2]) * v[2] - wave * v[0] - rate * q[0]
    g2 = 2 * v[0] ** 2 - 0.3 * np.sin(q[2]) * v[2] ** 2 - 2 * rate * v[0] + 9 * wave * q[0]
    g2 += 2 * q[0] * a[0] + a[1] + 0.3 * np.cos(q[2]) * a[2] - wave * a[0]
    k = v[2] + 0.2 * v[0] * v[1] - 0.5 * np.cos(q[0] + t)
    k1 = a[2] + 0.2 * (a[0] * v[1] + v[0] * a[1]) + 0.5 * np.sin(q[0] + t) * (v[0] + 1)
    return {"g": g, "g1": g1, "g2": g2, "k": k, "k1": k1}


@pytest.mark.parametrize(
    ("name", "held"),
    [("index3", "g k"), ("index2", "g1 k"), ("ggl", "g1 k g"), ("index1", "g2 k1"), ("integrated", "g1 k g")],
)
def test_the_equations_of_each_form_are_those_written_by_hand(name, held):
    """Off the motion, where every level has its own value: which of them a form holds, and where eta acts."""
    t, q, v, qdot, a = 0.2, Q3, V3, np.array([0.1, 0.5, -0.3]), np.array([-0.4, 0.2, 0.7])
    lam, mu, eta = np.array([0.6]), np.array([-0.8]), np.array([0.9])
    form = make_form(name, derive(RICH_NUMPY, t, q, v))
    y, yp = np.zeros(form.size), np.zeros(form.size)
    quantities = y if "lam" in form.blocks else yp
    for vector, block, value in ((y, "q", q), (y, "v", v), (yp, "q", qdot), (yp, "v", a)):
        vector[form.blocks[block]] = value
    for block, value in (("lam", lam), ("mu", mu), ("eta", eta)):
        place = form.blocks.get(block) or form.blocks.get(block.capitalize())
        if place:
            quantities[place] = value
    direction = np.array([2 * q[0] - 0.2 * np.sin(3 * t), 1.0, 0.3 * np.cos(q[2])])
    k_v = np.array([0.2 * v[1], 0.2 * v[0], 1.0])
    forces = rich_mass(np, t, q) @ a - rich_force(np, t, q, v) - rich_reaction(np, t, q, lam) + k_v * mu
    levels = levels_by_hand(t, q, v, a)
    rate = qdot - v + (direction * eta if name in ("ggl", "integrated") else 0.0)
    expected = np.concatenate([rate, forces, [levels[level] for level in held.split()]])
    np.testing.assert_allclose(form.residual(t, y, yp), expected, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("name", [name for name in SCENES if name != SLOW])
def test_jacobian_equals_central_differences_of_the_residual(name):
    """At a point off the motion, so that no term is zero by chance: eta and the rates of the multipliers too."""
    moment, together = scene(name)
    y, yp = together.start(*moment.packed)
    random = np.random.default_rng(5)
    y, yp = y + 0.1 * random.normal(size=y.size), yp + 0.1 * random.normal(size=y.size)
    exact, by_differences = together.jacobian(moment.t, y, yp, C), together.central_differences(moment.t, y, yp, C)
    for form, matrix in exact.items():
        scale = np.maximum(1.0, np.abs(by_differences[form]).max(axis=1, keepdims=True))
        error = np.abs(matrix - by_differences[form]) / scale
        assert error.max() < (NEWTON if name not in COMPILED else 1e-6), (form, np.argwhere(error == error.max()))


def implied_acceleration(moment, together, name):
    """v' that the form ``name`` implies at the state, from its residual alone.

    The force rows as they are and the constraint rows differentiated in time along the motion, as often as it takes to
    reach v' (twice for g, once for g' and k), are solved for v', lam and mu, starting from wrong accelerations.
    """
    form, rows = together.forms[name], next(x for x in together.layouts if x.name == name).rows
    n, sizes = moment.q.size, (moment.q.size, moment.lam.size, moment.mu.size)
    heights = {"position": sizes[1], "velocity": sizes[1], "acceleration": sizes[1]}
    times = {"position": 2, "velocity": 1, "velocity_constraint": 1}
    order = np.concatenate([np.full(heights.get(row, sizes[2]), times.get(row, 0)) for row in rows[2:]] or [np.zeros(0)])

    def residual_along(s, vdot, lam, mu):
        start = together.start(moment.q + s * moment.v + s**2 / 2 * vdot, moment.v + s * vdot, vdot, lam, mu)
        return together.residual(moment.t + s, *start)[name][n:]

    def equations(x):
        e = 1e-3 * min(1.0, 1.0 / np.abs(moment.v).max())
        at = [residual_along(i * e, *np.split(x, np.cumsum(sizes)[:-1])) for i in (-2, -1, 0, 1, 2)]
        first = (at[0] - 8 * at[1] + 8 * at[3] - at[4]) / (12 * e)
        second = (-at[0] + 16 * at[1] - 30 * at[2] + 16 * at[3] - at[4]) / (12 * e * e)
        return np.concatenate([at[2][:n], np.choose(order.astype(int), [at[2][n:], first[n:], second[n:]])])

    assert form.kind == "dae"
    scale = np.concatenate([np.full(size, max(1.0, np.abs(part).max(initial=0.0))) for size, part in
                            zip(sizes, (moment.vdot, moment.lam, moment.mu), strict=True)])  # fmt: skip
    x = np.concatenate([moment.vdot + scale[:n], moment.lam, moment.mu])
    for _ in range(4):  # one is enough where the reaction is linear in lam
        columns = [(equations(x + d) - equations(x - d)) / 2 for d in 1e-2 * np.diag(scale)]
        x = x - 1e-2 * scale * np.linalg.lstsq(np.stack(columns, axis=1), equations(x), rcond=1e-14)[0]
    return x[:n]


@pytest.mark.parametrize("name", COMPILED)
def test_every_form_implies_the_acceleration_of_the_ode(name):
    """Where the reaction is nonlinear, and there is no ode, that of the KKT level."""
    moment, together = scene(name)
    expected = moment.vdot
    if "ode" in together.names:
        y, yp = together.start(*moment.packed)
        rate = yp - np.concatenate(list(together.residual(moment.t, y, yp).values()))
        expected = rate[-moment.q.size :]  # the ode comes last
    for form in together.names:
        if form != "ode":
            found = implied_acceleration(moment, together, form)
            assert np.abs(found - expected).max() < 1e-5 * max(1.0, np.abs(expected).max()), form
