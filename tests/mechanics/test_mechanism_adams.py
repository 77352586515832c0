"""Single joints and springs against figures of ADAMS: positions, velocities, accelerations, reactions.

Source: Project Chrono, data/testing/joints at 7689fbc, BSD-3.  Of 501 rows of each case these are four, with all printed
digits.  ADAMS prints six or seven.  Its own tolerance shows where two of its models are one motion: the bars on a spherical
and on a universal joint move as the one on a revolute joint; its positions differ by 8.4e-4 m of 2 m, its forces by 4e-4
of their peak.
"""

from __future__ import annotations

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.mechanics import Mechanism

TIMES = [0.5, 1.2, 2.9, 5.0]
# Of each row: position, velocity, acceleration and force on the ground, each along the bar's plane and up;
# angular velocity, angular acceleration and torque on the ground about the plane's normal.
ADAMS = {
    "Revolute": [
        [1.66081, -1.11432, -2.57277, -3.8345, -13.2797, -0.657404, 13.2797, -9.14925, 2.30881, 3.97227, 0],
        [-1.67249, -1.09672, -2.51203, 3.83083, 13.1624, -0.936317, -13.1624, -8.87033, 2.2905, -4.00061, 0],
        [1.68389, -1.07913, 2.45185, 3.8259, -13.039, -1.21129, 13.039, -8.59536, -2.27206, 4.02798, 0],
        [-1.99968, -0.0355587, -0.0146657, 0.824742, 0.510225, -9.55839, -0.510225, -0.248259, 0.412436, -4.78297, 0],
    ],
    "Spherical": [
        [1.66081, -1.11432, -2.57277, -3.8345, -13.28, -0.657179, 13.28, -9.14947, 2.30881, 3.97267, 0],
        [-1.67246, -1.09676, -2.51207, 3.83058, 13.1613, -0.936549, -13.1613, -8.8701, 2.29041, -4.00042, 0],
        [1.68385, -1.07918, 2.45156, 3.82508, -13.036, -1.21266, 13.036, -8.59399, -2.27164, 4.02766, 0],
        [-1.99967, -0.0361929, -0.0148923, 0.822711, 0.511671, -9.5582, -0.511671, -0.248448, 0.411423, -4.78295, 0],
    ],
    "Cylindrical": [
        [2, -1.22583, 0, -4.90333, 0, -9.80665, 0, 0, 0, 0, 0],
        [2, -7.06079, 0, -11.768, 0, -9.80665, 0, 0, 0, 0, 0],
        [2, -41.237, 0, -28.4393, 0, -9.80665, 0, 0, 0, 0, 0],
        [2, -122.583, 0, -49.0333, 0, -9.80665, 0, 0, 0, 0, 0],
    ],
    "Prismatic": [
        [2, -1.22583, 0, -4.90333, 0, -9.80665, 0, 0, 0, 0, 0],
        [2, -7.06079, 0, -11.768, 0, -9.80665, 0, 0, 0, 0, 0],
        [2, -41.237, 0, -28.4393, 0, -9.80665, 0, 0, 0, 0, 0],
        [2, -122.583, 0, -49.0333, 0, -9.80665, 0, 0, 0, 0, 0],
    ],
    "Universal": [
        [1.66081, -1.11432, -2.57277, -3.8345, -13.2796, -0.65747, 13.2796, -9.14918, -2.30881, -3.97249, 0],
        [-1.67246, -1.09676, -2.51207, 3.83058, 13.1613, -0.936548, -13.1613, -8.8701, -2.29041, 4.00041, 0],
        [1.68385, -1.07918, 2.45156, 3.82508, -13.036, -1.21266, 13.036, -8.59399, 2.27164, -4.02767, 0],
        [-1.99967, -0.0361929, -0.0148923, 0.822711, 0.511669, -9.5582, -0.511669, -0.248448, -0.411423, 4.78295, 0],
    ],
    "Distance": [
        [1.64457, -1.138152, -2.68872, -3.885061, -13.76685, -0.2790767, 13.76685, -9.527573, 0, 0, 0],
        [-1.708487, -1.039747, -2.347668, 3.857631, 13.06536, -1.855368, -13.06536, -7.951282, 0, 0, 0],
        [1.763984, -0.9425297, 2.026226, 3.792166, -12.22846, -3.272755, 12.22846, -6.533895, 0, 0, 0],
        [-1.999998, -0.002779575, -0.0003244973, 0.2334878, 0.04099856, -9.806593, -0.04099856, -5.697934e-05, 0, 0, 0],
    ],
    "RotSpring": [
        [
            1.977294,
            -0.3005134,
            0.03481927,
            0.229101,
            0.6784321,
            4.641644,
            -0.6784321,
            -14.44829,
            -0.115866,
            -2.345232,
            29.00693,
        ],
        [
            1.98929,
            -0.2066963,
            -0.03010471,
            -0.2897344,
            0.09120428,
            1.29251,
            -0.09120428,
            -11.09916,
            0.1456471,
            -0.6476587,
            22.16307,
        ],
        [
            1.990776,
            -0.1918667,
            -0.003601097,
            -0.03736439,
            -0.006276944,
            -0.05767441,
            0.006276944,
            -9.748976,
            0.01876876,
            0.02904654,
            19.40391,
        ],
        [
            1.990439,
            -0.1953254,
            -1.562778e-06,
            -1.592452e-05,
            0.002108525,
            0.02148667,
            -0.002108525,
            -9.828137,
            8.000521e-06,
            -0.01079494,
            19.5638,
        ],
    ],
    "TranSpring": [
        [0, -0.9167, 0, -2.74529, 0, 0.733002, 0, -10.5397, 0, 0, 0],
        [0, -1.5973, 0, 1.37863, 0, 5.47704, 0, -15.2837, 0, 0, 0],
        [0, -1.42624, 0, -0.42054, 0, 4.66597, 0, -14.4726, 0, 0, 0],
        [0, -1.26242, 0, 0.0480496, 0, 2.79355, 0, -12.6002, 0, 0, 0],
    ],
}
JOINTS = {
    "Revolute": "hinge",
    "Spherical": "ball",
    "Cylindrical": "tube",
    "Prismatic": "rail",
    "Universal": "cardan",
    "Distance": "rod",
    "RotSpring": "sprung hinge",
    "TranSpring": "spring",
}
# The least of the peaks of all cases in which it is not zero.
PEAKS = {"velocity": 1.06, "acceleration": 9.8, "force": 15.0, "rate": 0.53, "angular acceleration": 4.7, "torque": 31.0}


def mechanism():
    """The eight models side by side, as their .adm files describe them.

    The spring's rows are those of 10 N/m, 0.5 N s/m and no free length (least squares over its rows, residual 1e-7), the
    hinge's spring has 200 N m/rad and 10 N m s/rad; their .adm files hold other constants.
    """
    m = Mechanism(gravity=(0, 0, -9.80665))
    origin, (x, y, z) = (0, 0, 0), np.eye(3)
    for name in ("Revolute", "Spherical", "Cylindrical", "Prismatic", "RotSpring"):
        m.body(name, 1.0, (0.04, 0.1, 0.1), at=(2, 0, 0))
    m.body("Universal", 1.0, (0.1, 0.04, 0.1), at=(0, 2, 0))
    m.body("Distance", 1.0, (0.04, 0.1, 0.1), at=(0, 2, 0))
    m.body("TranSpring", 1.0, (0.04, 0.1, 0.1), at=(0, 0, -1e-7))  # at 0 the spring has no direction
    m.revolute("hinge", "ground", "Revolute", origin, y)
    m.spherical("ball", "ground", "Spherical", origin)
    m.cylindrical("tube", "ground", "Cylindrical", origin, z)
    m.prismatic("rail", "ground", "Prismatic", origin, z)
    m.universal("cardan", "ground", "Universal", origin, x, z)
    m.distance("rod", "ground", "Distance", origin, (0, 2, 0))
    m.revolute("sprung hinge", "ground", "RotSpring", origin, y)
    m.torsion("torsion spring", "sprung hinge", 200.0, 10.0)
    m.spring("spring", "ground", "TranSpring", origin, (0, 0, -1e-7), 10.0, 0.5, free=0.0)
    return m


@pytest.fixture(scope="module")
def solved():
    m = mechanism()
    return m, hb.solve(m.problem((0, 5)), "projected", rtol=1e-8, t_eval=TIMES)


def found(m, solution, case):
    """Vectors (times, 3) in space, by name; force and torque are those on the ground, the first of the joint."""
    body, joint = m.of(solution, case), m.of(solution, JOINTS[case])
    if case == "TranSpring":
        force = joint.tension()[:, None] * body.position() / joint.measure()[:, None]
        torque = np.zeros_like(force)
    else:
        force, torque = -joint.force(), -joint.torque()
    if case == "RotSpring":  # printed: hinge and spring together
        torque[:, 1] += m.of(solution, "torsion spring").tension()
    return {
        "position": body.position(),
        "velocity": body.velocity(),
        "acceleration": body.acceleration(),
        "force": force,
        "rate": body.rate(),
        "angular acceleration": body.angular_acceleration(),
        "torque": torque,
    }


def printed(case, rows):
    """Vectors (times, 3) of ``rows`` of ``case``."""
    rows, along, about = np.array(rows), *((1, 0) if case in ("Universal", "Distance") else (0, 1))
    vectors = {}
    for i, name in enumerate(("position", "velocity", "acceleration", "force")):
        vectors[name] = np.zeros((len(TIMES), 3))
        vectors[name][:, [along, 2]] = rows[:, 2 * i : 2 * i + 2]
    for i, name in enumerate(("rate", "angular acceleration", "torque")):
        vectors[name] = np.zeros((len(TIMES), 3))
        vectors[name][:, about] = rows[:, 8 + i]
    return vectors


@pytest.mark.parametrize("case", ADAMS)
def test_motion_and_reactions_are_those_of_adams(solved, case):
    """Motion to 1e-5 of its size (printed digits), accelerations and reactions to 1e-3 of their peak (ADAMS' own)."""
    m, solution = solved
    expected = printed(case, ADAMS[case])
    for name, value in found(m, solution, case).items():
        size = max(abs(expected[name]).max(), PEAKS.get(name, 0.0))
        bound = 1e-5 if name in ("position", "velocity", "rate") else 1e-3
        if case in ("Spherical", "Universal"):
            bound = 1e-3  # by which ADAMS differs from itself, see above
        np.testing.assert_allclose(value, expected[name], rtol=0, atol=bound * size, err_msg=name)


@pytest.mark.parametrize("case", ["Spherical", "Universal"])
def test_one_motion_on_three_joints_is_the_one_of_the_revolute_joint(solved, case):
    """Bars on a ball and on a Cardan joint swing as on a hinge: ADAMS' rows of the hinge hold for them to 1e-5."""
    m, solution = solved
    sign = -1.0 if case == "Universal" else 1.0  # about x instead of y
    hinge, own = printed("Revolute", ADAMS["Revolute"]), found(m, solution, case)
    along, about = (1, 0) if case == "Universal" else (0, 1)
    for name in ("position", "velocity"):
        expected = hinge[name][:, [0, 2]]
        np.testing.assert_allclose(own[name][:, [along, 2]], expected, rtol=0, atol=1e-5 * abs(expected).max())
    np.testing.assert_allclose(own["rate"][:, about], sign * hinge["rate"][:, 1], rtol=0, atol=1e-5 * 3.1)
