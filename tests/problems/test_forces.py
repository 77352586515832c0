"""Force, mass, energy and power of one problem belong together."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.protocol.system import declared
from tests.problems.cases import CHANGED, FURTHER, RANKS
from tests.problems.mechanics import compiled, consistent_state
from tests.sample import slow

LAGRANGE = [  # undamped; quaternions without norm inertia, which the energy does not see
    ("jay_negrut_pendulum", {"c": 0.0}),
    ("andrews", {}),
    ("rolling_disk3d_steady", {"j0": 0.0}),
    ("oscillator_chain", {}),
    ("car_axis", {}),
    ("slider_crank_flexible", {}),
    ("fekete", {"n_points": 5, "damping": 0.0}),
    ("sundials_slider_crank", {"c": 0.0}),
    ("clamped_bar_impact", {}),
    ("hf_linear_constrained", {}),
    ("fput_chain", {}),
    ("heavy_top", {"j0": 0.0}),
    ("bricard", {}),
    ("flyball_governor", {"C": 0.0}),
    ("planar_chain", {"n_links": 4, "m": 2.0, "L": 3.0, "g": 5.0}),
    ("bushing_chain", CHANGED["bushing_chain"] | {"n_bars": 3, "c": 0.0, "turning_c": 0.0}),
    (
        "band_track",
        {"n_wrap": 3, "n_free": 1, "c": 0.0, "turning_c": 0.0, "loss": 0.0, "mu": 0.0, "motor": 0.0, "brake": 0.0},
    ),
    ("ball_mill", {"n_balls": 2, "mount_c": 0.0, "c": 0.0, "mu": 0.0, "push": 0.0}),
    ("cam_follower", CHANGED["cam_follower"] | {"c": 0.0, "mu": 0.0}),
    ("train_buffers", {"c": 0.0}),
    ("bead_chain", {"n_beads": 3, "m": 2.0, "L": 1.5, "g": 4.0, "w": -0.7}),
    ("cable_pendulum", {"n_elements": 3, "damping": 0.0}),
    ("cable_pendulum", {"n_elements": 2, "dimension": 3, "damping": 0.0}),
    ("falling_net", {"n_side": 3, "damping": 0.0}),
    ("flexible_crank", {"n_elements": 3, "beta": 0.0}),
    ("spinup_beam", {"n_elements": 3}),
    ("stiff_spring_pendulum", CHANGED["stiff_spring_pendulum"]),
    ("stiff_spring_pendulum", CHANGED["stiff_spring_pendulum"] | {"stiffness": math.inf}),
    ("slider_crank_equal_lengths", CHANGED["slider_crank_equal_lengths"]),
    ("four_bars", {"n_windows": 3, "m": 2.0, "l": 0.5, "g": 4.0, "speed": 0.8}),
    *(
        (name, CHANGED[name])
        for name in (
            "chaplygin_sleigh",
            "rolling_disk_incline",
            "nonholonomic_particle",
            "bead_on_rotating_rod",
            "pendulum_period2",
            "simple_pendulum",
            "redundant_pendulum",
            "driven_coordinate",
            "kapitza_pendulum",
        )
    ),
]


@pytest.mark.parametrize(("name", "parameters"), LAGRANGE)
def test_force_is_what_lagrange_derives_from_mass_and_energy(make, name, parameters):
    """F = dT/dq - d(M v)/dq v - dV/dq with T = v M v / 2 and V the energy at rest, at a state off the constraints."""
    problem, t = make(name, **parameters), 0.37
    system, random = problem.system, np.random.default_rng(3)
    if getattr(system, "j0", None) is not None:
        system = dataclasses.replace(system, j0=0 * system.j0)
    mass = getattr(system, "mass_matrix", 1.0)
    q = problem.q0 + 0.1 * random.standard_normal(problem.q0.size)
    v = random.standard_normal(q.size)

    def momentum(q, v):
        M = jnp.asarray(mass(t, q) if callable(mass) else mass)
        return M @ v if M.ndim == 2 else M * v

    @jax.jit
    def compare(q, v):
        inertial = jax.grad(lambda x: v @ momentum(x, v) / 2)(q) - jax.jvp(lambda x: momentum(x, v), (q,), (v,))[1]
        expected = inertial - jax.grad(lambda x: system.energy(t, x, 0 * v))(q)
        energy = system.energy(t, q, v)
        return system.force(t, q, v), expected, energy - system.energy(t, q, 0 * v), v @ momentum(q, v) / 2, energy

    force, expected, kinetic, quadratic, energy = compare(q, v)
    np.testing.assert_allclose(force, expected, rtol=1e-11, atol=1e-13 * np.abs(expected).max())
    np.testing.assert_allclose(kinetic, quadratic, rtol=1e-11, atol=1e-13 * abs(energy))


POWER = [
    *((name, {}) for name in RANKS),
    *(
        (name, CHANGED[name])
        for name in (
            *("chaplygin_sleigh", "rolling_disk_incline", "nonholonomic_particle", "bead_on_rotating_rod", "andrews"),
            *("pendulum_period2", "simple_pendulum", "driven_coordinate", "kapitza_pendulum", "sundials_slider_crank"),
            *("car_axis", "slider_crank_flexible", "clamped_bar_impact", "hf_linear_constrained", "fput_chain"),
            *("oscillator_chain", "jay_negrut_pendulum", "knife_edge", "slider_crank_equal_lengths"),
            "stiff_spring_pendulum",
        )
    ),
    *(
        case
        for case in FURTHER
        if case[0]
        in (
            "planar_chain",
            "bead_chain",
            "four_bars",
            "bushing_chain",
            "train_buffers",
            "belt_drive",
            "cable_pendulum",
            "falling_net",
            "mooring_line",
            "flexible_crank",
            "right_angle_cantilever",
            "spinup_beam",
        )
    ),
    ("cam_follower", CHANGED["cam_follower"]),
    ("ball_mill", CHANGED["ball_mill"] | {"n_balls": 2}),
    ("band_track", CHANGED["band_track"] | {"n_wrap": 3, "n_free": 1}),
    ("arevalo_circle", {"c": 0.6, "t_start": 0.0, "t_end": 4.0}),
    ("fekete", {"n_points": 5, "damping": 0.1}),
]

LARGE = ("ball_mill", "band_track", "bushing_chain", "cable_pendulum", "flyball_governor", "right_angle_cantilever")


def _rates(system, t, q, v, vdot, lam, mu):
    """Change of the energy and of the invariants along a motion, and the declared power."""
    along = (jnp.ones_like(t), v, vdot)
    power = system.power(t, q, v, lam, mu) if declared(system, "power") else 0.0
    changes = jax.jvp(system.invariants, (t, q, v), along)[1] if declared(system, "invariants") else {}
    return jax.jvp(system.energy, (t, q, v), along)[1], power, changes


@pytest.mark.parametrize(("name", "parameters"), [slow(*x) if x[0] in LARGE else x for x in POWER])
def test_energy_changes_by_the_declared_power_and_invariants_not_at_all(make, mechanics, name, parameters):
    """At random consistent states, with the accelerations and multipliers of the acceleration level."""
    problem = make(name, **parameters)
    physics = compiled(problem.system)
    system, fed = mechanics(physics), []
    for seed in range(2):
        t, q, v = consistent_state(problem, system, seed, RANKS.get(name))
        np.testing.assert_allclose(system.position_rate(t, q, v), 0.0, atol=1e-12 * np.max(problem.scales.v))
        vdot, lam, mu = system.accelerations(t, q, v, redundant="redundant" in problem.tags)
        rate, expected, changes = system._of(_rates, t, q, v, vdot, lam, mu)
        size = np.abs(v * np.asarray(physics.force(t, q, v))).sum() + np.abs(v * (system.mass(t, q) @ vdot)).sum() + 1e-300
        fed.append(abs(expected) > 1e-6 * size)
        np.testing.assert_allclose(rate, expected, rtol=0, atol=1e-11 * size)
        scale = 1 + np.abs(vdot).max() * max(1.0, np.abs(q).max(), np.abs(v).max())
        assert all(abs(x) < 1e-12 * scale for x in changes.values()), changes
    assert any(fed) == hasattr(physics, "power")
