"""Every accepted step satisfies the equations of its method, by an oracle that shares no code with the loops."""

from __future__ import annotations

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.catalogue.registry import load_problem
from solvers.hht import HHT
from solvers.hht.rivals import GeneralisedAlphaIntegrator, HHTI3Integrator, RattleIntegrator
from tests.hht.oracle import (
    HHTI3,
    LEFT_BY_CONTROL,
    Extended,
    GeneralisedAlpha,
    Rattle,
    physics_of,
    steps_of,
)
from tests.hht.test_crane import Crane
from tests.problems.mechanics import Mechanics
from tests.sample import LIBRARY, slow

RTOL = 1e-3
ROUNDOFF = 1e-12  # of the largest q and v; Newton's iteration ends at 1e-13
NOISY = {  # one roundoff of q makes M^-1 F noise
    "bushing_chain": 1e-9,  # 7e7 N/m on 0.001 kg m^2: 1e-6 rad/s^2, over steps of some ms
    "cable_pendulum": 1e-11,  # light slopes: 2e-12 of v
    "mooring_line": 1e-9,  # 9e7 N/m on 5 kg at 50 m: 2e-7 m/s^2
    "flexible_crank": 1e-10,  # 4e6 N of shear on 2e-7 kg m^2
    "right_angle_cantilever": 1e-8,  # from rest: 1e6 N on 5 kg at 10 m, 2e-12 m/s of 4e-3
    "spinup_beam": 1e-6,  # from rest: 2.8e7 N on 1.5 kg at 10 m, 3e-10 m/s of 5e-4
    "flyball_governor": 1e-9,  # light joints: 2e-12 of v
}

FIRST = {"spinup_beam": 0.2}  # from rest, stiff: its first step is accepted with 0.11 left, ten times what (H35) estimated


def tolerances(problem):
    n = problem.q0.size
    return RTOL * np.concatenate([np.broadcast_to(problem.scales.q, n), np.broadcast_to(problem.scales.v, n)])


def assert_solved(left, s, rtol=None, atol=0.0, roundoff=ROUNDOFF, first=LEFT_BY_CONTROL):
    """Forces to the part of the tolerance that (H35) leaves, or to roundoff; constraints to roundoff always.

    ``first``: the part that the first step may leave.
    """
    worst = left.of_sizes(s, forces=rtol is None)
    assert worst.max() <= roundoff, f"step {worst.argmax()} of {worst.size} leaves {worst.max():.1e} of q or v"
    if rtol is not None:
        of_forces = left.of_tolerance(s, rtol, atol)
        over = of_forces / np.r_[first, np.full(of_forces.size - 1, LEFT_BY_CONTROL)]
        assert over.max() <= 1, f"step {over.argmax()} of {over.size}: {of_forces[over.argmax()]:.1e}"


# --- the library


@pytest.mark.parametrize("name", LIBRARY)
@pytest.mark.filterwarnings("ignore:redundant constraints")
def test_every_step_of_the_library_solves_its_equations(name):
    """Under error control to an end that cuts the last step, then in prescribed steps 1 : 2 of about half that length."""
    problem = load_problem(name)
    atol = tolerances(problem)
    hht, terms, roundoff = HHT(problem.system), physics(name), NOISY.get(name, ROUNDOFF)

    def solve(end, **how):
        guesses = {"lam_guess": problem.lam_guess, "mu_guess": problem.mu_guess}
        return hht.solve((problem.t_span[0], end), problem.q0, problem.v0, **guesses, **how)

    ahead = solve(problem.t_span[1], rtol=RTOL, atol=atol, max_num_steps=25)
    controlled = solve(ahead.t[-1] - 0.3 * (ahead.t[-1] - ahead.t[-2]), rtol=RTOL, atol=atol)
    s = steps_of(controlled, terms)
    first = FIRST.get(name, LEFT_BY_CONTROL)
    assert_solved(Extended().left(terms, s, start="trapezoidal"), s, RTOL, atol, roundoff, first)
    lengths = np.median(s.h) / 2 * np.tile([1.0, 2.0], 10)
    lengths[-1] *= 0.3
    prescribed = solve(problem.t_span[0] + lengths.sum(), steps=lengths)
    assert prescribed.success
    assert controlled.success
    s = steps_of(prescribed, terms)
    assert_solved(Extended().left(terms, s), s, roundoff=roundoff)


# --- from rest in equilibrium


class Driven(hb.System):
    """A mass on a spring whose other end moves as t^4."""

    def force(self, t, q, v):
        return jnp.stack([q[1] - q[0], q[0] - q[1]])

    def constraint(self, t, q):
        return jnp.stack([q[0] - t**4])


class Belt(hb.System):
    """A block on a belt that begins to move: (x, y), held at y = 0, friction drags it."""

    def force(self, t, q, v):
        return jnp.array([0.0, -9.81])

    def constraint(self, t, q):
        return jnp.stack([q[1]])

    def reaction(self, t, q, v, lam):
        return -lam[0] * jnp.stack([0.3 * jnp.tanh((t**2 - v[0]) / 0.1), 1.0])


class Skate(hb.System):
    """A knife edge at rest that forces push along and turn."""

    def force(self, t, q, v):
        return jnp.stack([jnp.sin(t), jnp.sin(2.0 * t), t**2])

    def velocity_constraint(self, t, q, v):
        return jnp.stack([v[0] * jnp.sin(q[2]) - v[1] * jnp.cos(q[2])])


class Brake(hb.System):
    """A free mass that a force pushes against steep friction."""

    def force(self, t, q, v):
        return 20.0 * jnp.sin(t) - 30.0 * jnp.tanh(v / 0.05)


class Held(hb.System):
    """A point that a constraint holds in the origin under a load, beside nothing that moves."""

    def force(self, t, q, v):
        return 50.0 * jnp.stack([jnp.sin(40.0 * t)])

    def constraint(self, t, q):
        return q


class Turned(hb.System):
    """A mass on a stiff spring, whose root a motor turns from rest: (x, y, angle)."""

    def force(self, t, q, v):
        spring = 1e4 * (jnp.stack([jnp.cos(q[2]), jnp.sin(q[2])]) - q[:2])
        return jnp.append(spring, 0.0)

    def constraint(self, t, q):
        return jnp.stack([q[2] - 40.0 * t**3])


SCENES = {  # a start in equilibrium, and the velocities that may be added to it
    "crane": (Crane(), [0.0, 0.0, -4.0], [1.0, 1.0, 0.0]),
    "driven": (Driven(), [0.0, 0.0], [0.0, 1.0]),
    "belt": (Belt(), [0.0, 0.0], [1.0, 0.0]),
    "skate": (Skate(), [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]),
    "brake": (Brake(), [0.0], [1.0]),
    "turned": (Turned(), [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
}
LENGTHS = {  # of constant steps [s]
    "crane": (10.0, 0.5, 0.1, 0.02),
    "driven": (10.0, 1 / 30, 1e-4),
    "belt": (0.5, 0.02),
    "skate": (0.5, 1 / 30),
    "brake": (0.5, 1 / 30),
    "turned": (1e-2, 1e-4),
}


@cache
def physics(name):
    """Of a scene, or of a problem of the library."""
    return physics_of(SCENES[name][0] if name in SCENES else load_problem(name).system)


SPEEDS = (0.0, 1e-20, 1e-14, 1e-8)


@pytest.mark.parametrize("speed", SPEEDS)
@pytest.mark.parametrize(("scene", "h"), [(scene, h) for scene in SCENES for h in LENGTHS[scene]])
def test_constant_steps_from_rest_solve_their_equations(scene, h, speed):
    system, q0, v0 = SCENES[scene]
    count = 1 if (scene, h) == ("crane", 10.0) else 20  # steps that swing the load round and round do not converge
    solution = HHT(system).solve((0.0, count * h), q0, speed * np.array(v0), step=h)
    assert solution.success, solution.message
    s = steps_of(solution, physics(scene))
    assert_solved(Extended().left(physics(scene), s), s)


@pytest.mark.parametrize("speed", SPEEDS)
@pytest.mark.parametrize("scene", SCENES)
def test_controlled_steps_from_rest_solve_their_equations(scene, speed):
    system, q0, v0 = SCENES[scene]
    solution = HHT(system).solve((0.0, 1.0), q0, speed * np.array(v0), rtol=RTOL, atol=1e-5)
    assert solution.success, solution.message
    s = steps_of(solution, physics(scene))
    assert_solved(Extended().left(physics(scene), s, start="trapezoidal"), s, RTOL, 1e-5)


@pytest.mark.parametrize("rows", [None, np.linspace(0.0, 1.0, 301)], ids=["at steps", "between steps"])
@pytest.mark.parametrize("steps", [25, 1000])
def test_a_point_held_in_the_origin_shows_its_load(steps, rows):
    """Interpolated multipliers of the steps, four a period, would be off by tens of N."""
    solution = HHT(Held()).solve((0.0, 1.0), [0.0], [0.0], steps=steps, t_eval=rows)
    assert solution.success, solution.message
    assert np.abs(solution.lam[:, 0] - 50.0 * np.sin(40.0 * solution.t)).max() < 1e-12


def test_rejected_first_steps_from_rest_are_followed_by_shorter_ones():
    solution = HHT(Turned(), first_step=0.1).solve((0.0, 0.5), [1.0, 0.0, 0.0], np.zeros(3), rtol=RTOL, atol=1e-5)
    assert solution.success, solution.message
    assert solution.counters.steps_rejected_error > 0
    assert solution.steps_data.h[0] < 0.1


@pytest.mark.parametrize(
    ("name", "request_", "options"),
    [
        slow("flyball_governor", {"rtol": 0.1}, {}),
        *(("simple_pendulum", {"rtol": 1e-3, "atol": 10.0}, options) for options in ({}, {"b": 1.0}, {"alpha": -0.3})),
        ("simple_pendulum", {"atol": 1e4}, {"alpha": -0.3}),
    ],
)
def test_both_levels_hold_to_roundoff_at_tolerances_that_allow_everything(name, request_, options):
    problem = load_problem(name)
    solution = hb.solve(problem, hb.load_solver("hht", **options), **request_)
    drift = solution.drift()
    assert drift.position.max() < 1e-11
    assert drift.velocity.max() < 1e-10


# --- the other methods of the loop


def of_extended(**options):
    """An HHT with ``options``, its equations, and whether multipliers are extrapolated."""
    own = {name: x for name, x in options.items() if name in ("alpha", "b", "reaction")}
    return lambda system: HHT(system, **options), Extended(**own)


RHO = 0.8
ALPHA_M, ALPHA_F = GeneralisedAlpha(rho=RHO, stabilised=True).alphas
EXTENDED = Extended(alpha=ALPHA_M - ALPHA_F, alpha_m=ALPHA_M)
METHODS = {
    "alpha -0.3": of_extended(alpha=-0.3),
    "alpha 0": of_extended(alpha=0.0),
    "b 1": of_extended(b=1.0),
    "predictor": of_extended(reaction="predictor", b=0.3),
    "midpoint": of_extended(reaction="midpoint"),
    "midpoint_predictor": of_extended(reaction="midpoint_predictor"),
    "extrapolated": of_extended(extrapolate_reaction=True),
    "extrapolated midpoint": of_extended(extrapolate_reaction=True, reaction="midpoint"),
    "stabilised": (GeneralisedAlphaIntegrator, GeneralisedAlpha(rho=RHO, stabilised=True)),
    "index 3": (
        lambda system: GeneralisedAlphaIntegrator(system, form="index3"),
        GeneralisedAlpha(rho=RHO, stabilised=False),
    ),
    "extended": (lambda system: GeneralisedAlphaIntegrator(system, form="extended"), EXTENDED),
    "hht_i3": (HHTI3Integrator, HHTI3()),
    "rattle": (RattleIntegrator, Rattle()),
}


def assert_solved_by(method, name, system, solution):
    """That the steps of ``solution`` solve the equations of ``method``, begun as THEORY.md says."""
    assert solution.success
    oracle, terms, mechanics = METHODS[method][1], physics(name), Mechanics(system)
    s = steps_of(solution, terms)
    t, h, q, v = s.t0[0], s.h[0, 0], s.q0[0], s.v0[0]
    vdot, lam, _ = mechanics.accelerations(t, q, v)
    shift = h * (ALPHA_M - ALPHA_F)  # (H12), (H41)
    place = t + shift, q + shift * v, v + shift * vdot
    given = {}
    if isinstance(oracle, HHTI3):
        given = {"vdot": vdot, "lam": lam}
    elif isinstance(oracle, GeneralisedAlpha):
        given = {"vdot": vdot, "start": mechanics.accelerations(*place)[0]}
    elif oracle is EXTENDED:
        given = {"start": terms(*([x] for x in (*place, s.lam0[0], s.mu[0]))).f[0]}
    elif method.startswith("extrapolated"):
        given = {"lam": lam}
    assert_solved(oracle.left(terms, s, **given), s)


TOP = load_problem("heavy_top")
MOVES = {  # a top, whose mass varies, in steps of 1 : 2, for every second method, and a crane from rest
    "heavy_top": (TOP.system, (0.0, 0.06), TOP.q0, TOP.v0, {"steps": np.tile([1e-3, 2e-3], 20)}),
    "crane": (Crane(), (0.0, 2.0), SCENES["crane"][1], np.zeros(3), {"step": 0.1}),
}


@pytest.mark.parametrize(
    ("method", "name"),
    [(method, name) for i, method in enumerate(METHODS) for name in (MOVES if i % 2 == 0 else ("crane",))],
)
def test_the_other_methods_solve_their_own_equations(method, name):
    system, *start, how = MOVES[name]
    assert_solved_by(method, name, system, METHODS[method][0](system).solve(*start, **how))
