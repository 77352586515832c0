"""The benchmark bicycle, a nonlinear mechanism, has the eigenvalues that are published for it."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

import hhtbench as hb

SCENE = Path(__file__).parent.parent.parent / "docs/scenes/bicycle.py"
PUBLISHED = {  # m/s: weave, capsize, castering [1/s] by Meijaard and others 2007, table 2
    0: (3.13164324790656, -3.13164324790656, 5.53094371765393, -5.53094371765393),
    1: (3.52696170990070 + 0.80774027519930j, -3.13423125066578, -7.11008014637442),
    2: (2.68234517512745 + 1.68066296590675j, -3.07158645641514, -8.67387984831735),
    3: (1.70675605663975 + 2.31582447384325j, -2.63366137253667, -10.35101467245920),
    4: (0.41325331521125 + 3.07910818603206j, -1.42944427361326, -12.15861426576447),
    5: (-0.77534188219585 + 4.46486771378823j, -0.32286642900409, -14.07838969279822),
    6: (-1.52644486584142 + 5.87673060598709j, -0.00406690076970, -16.08537123098026),
    7: (-2.13875644258362 + 7.19525913329805j, 0.10268170574766, -18.15788466125262),
    8: (-2.69348683581097 + 8.46037971396931j, 0.14327879765713, -20.27940894394569),
    9: (-3.21675402252485 + 9.69377351531791j, 0.15790184030917, -22.43788559040858),
    10: (-3.72016840437287 + 10.90681139476287j, 0.16105338653172, -24.62459635017404),
}


@pytest.fixture(scope="module")
def scene():
    return runpy.run_path(str(SCENE))


def canonical(speed):
    """Eigenvalues (4,) of ``M x'' + v C x' + (g K0 + v^2 K2) x = 0`` in lean and steer: appendix A of the paper."""
    w, c, tilt, g = 1.02, 0.08, np.pi / 10, 9.81
    m_B, x_B, z_B, m_H, x_H, z_H = 85.0, 0.3, -0.9, 4.0, 0.9, -0.7
    m_R, r_R, m_F, r_F = 2.0, 0.3, 3.0, 0.35
    B, H = (9.2, 2.4, 2.8), (0.05892, -0.00756, 0.00708)  # xx, xz, zz
    R, F = (0.0603, 0.12), (0.1405, 0.28)  # xx, yy
    m_T = m_R + m_B + m_H + m_F
    x_T, z_T = (x_B * m_B + x_H * m_H + w * m_F) / m_T, (-r_R * m_R + z_B * m_B + z_H * m_H - r_F * m_F) / m_T
    T_xx = R[0] + B[0] + H[0] + F[0] + m_R * r_R**2 + m_B * z_B**2 + m_H * z_H**2 + m_F * r_F**2
    T_xz = B[1] + H[1] - m_B * x_B * z_B - m_H * x_H * z_H + m_F * w * r_F
    T_zz = R[0] + B[2] + H[2] + F[0] + m_B * x_B**2 + m_H * x_H**2 + m_F * w**2
    m_A = m_H + m_F
    x_A, z_A = (x_H * m_H + w * m_F) / m_A, (z_H * m_H - r_F * m_F) / m_A
    A_xx = H[0] + F[0] + m_H * (z_H - z_A) ** 2 + m_F * (r_F + z_A) ** 2
    A_xz = H[1] - m_H * (x_H - x_A) * (z_H - z_A) + m_F * (w - x_A) * (r_F + z_A)
    A_zz = H[2] + F[0] + m_H * (x_H - x_A) ** 2 + m_F * (w - x_A) ** 2
    sin, cos = np.sin(tilt), np.cos(tilt)
    u = (x_A - w - c) * cos - z_A * sin
    A_ll = m_A * u**2 + A_xx * sin**2 + 2 * A_xz * sin * cos + A_zz * cos**2
    A_lx, A_lz = -m_A * u * z_A + A_xx * sin + A_xz * cos, m_A * u * x_A + A_xz * sin + A_zz * cos
    mu = c / w * cos
    S_F = F[1] / r_F
    S_T, S_A = R[1] / r_R + S_F, m_A * u + mu * m_T * x_T
    M = np.array([[T_xx, A_lx + mu * T_xz], [A_lx + mu * T_xz, A_ll + 2 * mu * A_lz + mu**2 * T_zz]])
    K0 = np.array([[m_T * z_T, -S_A], [-S_A, -S_A * sin]])
    K2 = np.array([[0, (S_T - m_T * z_T) * cos / w], [0, (S_A + S_F * sin) * cos / w]])
    right = mu * S_T + S_F * cos
    C = [[0, right + T_xz * cos / w - mu * m_T * z_T], [-right, A_lz * cos / w + mu * (S_A + T_zz * cos / w)]]
    lower = -np.linalg.solve(M, np.hstack([g * K0 + speed**2 * K2, speed * np.array(C)]))
    return np.linalg.eigvals(np.vstack([np.eye(2, 4, 2), lower]))


@pytest.mark.parametrize("speed", PUBLISHED)
def test_eigenvalues_are_the_published_ones(scene, speed):
    """To 1e-6; capsize at 6 m/s, near a block of zeros, is the worst by 2e-9."""
    found = scene["modes"](float(speed))
    assert np.count_nonzero(found.eigenvalues == 0.0) == 6  # place, heading, angles of the wheels, and speed
    values = found.eigenvalues[found.eigenvalues != 0.0]
    for expected in (np.array(PUBLISHED[speed]), np.unique([x for x in canonical(speed).round(12) if x.imag >= 0])):
        np.testing.assert_allclose(np.sort_complex(values), np.sort_complex(expected), rtol=0, atol=1e-6)
    assert found.stable == (speed in (5, 6))


def test_a_push_at_five_metres_a_second_dies_out_as_the_weave_says(scene):
    """The nonlinear motion from 1e-3 of the weave's shape: lateral motions are odd in it, so that 1e-6 is left."""
    problem, found, times = scene["problem"](5.0), scene["modes"](5.0), np.linspace(0.0, 1.0, 11)
    i = int(np.argmax(found.eigenvalues.imag))
    weave = found.eigenvalues[i]
    x = 1e-3 * found.shapes[:, i]
    turning = scene["along"](5.0)
    v = problem.v0 + (weave * x).real + np.asarray(turning(problem.q0 + x.real) - turning(problem.q0))
    start = problem.starting((0.0, 1.0), problem.q0 + x.real, v)
    solution = hb.solve(start, "projected", rtol=1e-9, t_eval=times, calc_initcond=True)
    lean = 2 * solution.q[:, 11]  # of the frame, whose shape stays as it does not spin
    expected = 2 * (x[11] * np.exp(weave * times)).real
    assert np.abs(expected).max() > 1e-4
    np.testing.assert_allclose(lean, expected, atol=1e-5 * np.abs(expected).max())
