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
from tests.sample import LIBRARY

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
LEFT_OUT = {  # `make validate` moves them by every form
    *("flyball_governor", "ball_mill"),  # slow: bodies in space as well
    *(
        "band_track",
        "belt_drive",
        "cam_follower",
    ),  # contact within centimetres, which differences over 1e-3 do not resolve to 1e-6
}
SCENES = [*(name for name in LIBRARY if not LEFT_OUT & {*name.values}), *SMALL]
SMALLER = {  # the same equations in a tenth of the time, and contact without kinks over a length that differences resolve
    "bushing_chain": "bushing_chain(n_bars=3)",
    "cable_pendulum": "cable_pendulum(n_elements=3, length=3)",
    "falling_net": "falling_net(n_side=3, width=1)",
    "fekete": "fekete(n_points=6)",
    "right_angle_cantilever": "right_angle_cantilever(n_elements=1)",
    "mooring_line": "mooring_line(n_segments=4, length=8, pull_z=900)",
    "train_buffers": "train_buffers(onset=1, c=0)",
}
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
    bound = size_of_forces(moment) * (DIFFERENCES if name.endswith("_numpy") else 1e-11)
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


@pytest.mark.parametrize("name", SCENES)
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
        assert error.max() < (NEWTON if name.endswith("_numpy") else 1e-6), (form, np.argwhere(error == error.max()))
