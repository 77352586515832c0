"""Starts, masses and names that were refused, or accepted, for the wrong reason: for every solver alike."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from click.testing import CliRunner

import hhtbench as hb
from hhtbench.catalogue.registry import load_solver
from hhtbench.checks.problem import check
from hhtbench.cli.output import FAILED
from hhtbench.cli.solve import solve_command
from hhtbench.protocol.errors import ProblemError
from hhtbench.solution.result import Status

SOLVERS = ("hht", "ida", "cvode", "scipy(method=Radau)", "projected", "collocation", "rattle")


class Load(hb.System):
    """A load of 5 kg on a rope of 4 m."""

    m: Any = hb.parameter(5.0)

    def mass_matrix(self, t: Any, q: Any) -> Any:
        return self.m * jnp.eye(2)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        return jnp.stack([0.0, -49.05])

    def constraint(self, t: Any, q: Any) -> Any:
        return jnp.stack([(q @ q - 16.0) / 2.0])


def caught(v0: list[float], angle: float = 0.0, m: float = 5.0) -> hb.Problem:
    q0 = [4.0 * np.sin(angle), -4.0 * np.cos(angle)]
    return hb.Problem(name="load", system=Load(m=m), t_span=(0.0, 0.1), q0=q0, v0=v0)


def accuracy(solver: str) -> dict[str, Any]:
    return {"steps": 10} if solver == "rattle" else {"rtol": 1e-6}


@pytest.mark.parametrize("solver", SOLVERS)
def test_every_solver_projects_a_start_on_request_and_says_what_to_type(solver: str):
    """The rope takes the velocity along it: 0.5 m/s downwards."""
    refused = hb.solve(caught([0.1, -0.5]), solver, **accuracy(solver))
    assert refused.status is Status.inconsistent_initial
    assert "pass calc_initcond=True" in refused.message
    found = hb.solve(caught([0.1, -0.5]), solver, calc_initcond=True, **accuracy(solver))
    assert found.success, found.message
    np.testing.assert_allclose(found.v[0], [0.1, 0.0], atol=1e-12)
    assert "calc_initcond moved q0 by 0 and v0 by 0.5" in found.message


class TwoRopes(Load):
    """The same rope twice."""

    def constraint(self, t: Any, q: Any) -> Any:
        return jnp.stack([(q @ q - 16.0) / 2.0, q @ q - 16.0])


@pytest.mark.parametrize("solver", ["hht", "ida"])
def test_redundant_rows_of_a_projected_start_are_told_once(solver: str):
    given = replace(caught([0.1, -0.5]), system=TwoRopes())
    with pytest.warns(UserWarning, match="redundant constraints") as warned:
        found = hb.solve(given, solver, rtol=1e-6, calc_initcond=True)
    assert found.success, found.message
    assert len(warned) == 1


def test_steps_by_hand_begin_at_the_projected_start():
    hht = hb.HHT(Load())
    assert hht.init_step(0.0, [0.0, -4.0], [0.1, -0.5], step=0.01) is Status.inconsistent_initial
    assert "pass calc_initcond=True to solve or init_step" in hht.message
    assert hht.init_step(0.0, [0.0, -4.0], [0.1, -0.5], step=0.01, calc_initcond=True) is Status.success
    np.testing.assert_allclose(hht.state.v, [0.1, 0.0], atol=1e-12)
    request = hb.Request(step=0.01, calc_initcond=True)
    by_adapter = load_solver("hht").stepper(caught([0.1, -0.5]), request)
    np.testing.assert_allclose(by_adapter.state.v, [0.1, 0.0], atol=1e-12)


def test_what_the_message_advises_can_be_typed_on_the_command_line(tmp_path: Path):
    file = tmp_path / "load.py"
    file.write_text(
        "from tests.adapters.test_consistent_starts import caught\n\n\ndef problem():\n    return caught([0.1, -0.5])\n"
    )
    refused = CliRunner().invoke(solve_command, [f"{file}:problem", "--rtol", "1e-6"])
    assert refused.exit_code == FAILED
    assert "--calc-initcond" in refused.output
    assert CliRunner().invoke(solve_command, [f"{file}:problem", "--rtol", "1e-6", "--calc-initcond"]).exit_code == 0


def test_what_the_constraints_leave_of_a_velocity_stays_however_little():
    """1e-9 m/s beside 0.5 m/s that the rope takes: the roundoff of what was taken is not counted against it."""
    found = hb.solve(caught([1e-9, 0.5]), "hht", rtol=1e-6, calc_initcond=True)
    assert found.success, found.message
    np.testing.assert_allclose(found.v[0], [1e-9, 0.0], rtol=1e-9, atol=1e-24)


@pytest.mark.parametrize(("v0", "angle"), [([0.0, 0.5], 0.0), ([0.5 * np.sin(0.3), -0.5 * np.cos(0.3)], 0.3)])
def test_a_velocity_that_the_constraints_take_wholly_leaves_a_start_at_rest(v0: list[float], angle: float):
    found = hb.solve(caught(v0, angle), "hht", rtol=1e-6, calc_initcond=True)
    assert found.success, found.message
    assert found.v[0].tolist() == [0.0, 0.0]


class Diagonal(hb.System):
    m: Any = hb.parameter(1.0)

    def mass_matrix(self, t: Any, q: Any) -> Any:
        return self.m * jnp.ones(q.size)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        return -q


@pytest.mark.parametrize(
    ("solver", "large"), [("hht", False), ("ida", False), ("projected", False), ("hht", True), ("scipy", True)]
)
@pytest.mark.parametrize("mass", [np.nan, np.inf])
def test_a_constant_mass_that_is_not_finite_is_named(solver: str, large: bool, mass: float):
    given = caught([0.0, 0.0], m=mass)
    if large:
        given = hb.Problem(name="p", system=Diagonal(m=mass), t_span=(0.0, 1.0), q0=np.ones(500), v0=np.zeros(500))
    found = hb.solve(given, solver, rtol=1e-5)
    assert found.status is Status.nonfinite_callback
    assert f"mass_matrix[0, 0] = {mass}" in found.message


class Falling(hb.System):
    def force(self, t: Any, q: Any, v: Any) -> Any:
        return jnp.stack([0.0, -9.81])


class Misspelt(Falling):
    def constraints(self, t: Any, q: Any) -> Any:
        return jnp.stack([q @ q - 1.0])


class Shortened(Falling):
    def mass(self, t: Any, q: Any) -> Any:
        return 2.0 * jnp.eye(2)


class Parameter(hb.System):
    """Its own functions read ``mass``."""

    mass: Any = hb.parameter(2.0)

    def mass_matrix(self, t: Any, q: Any) -> Any:
        return self.mass * jnp.stack([1.0 + q[0] ** 2, 1.0])

    def force(self, t: Any, q: Any, v: Any) -> Any:
        return self.mass * jnp.stack([0.0, -9.81])


class Unread(Falling):
    """Its field ``mass`` would be the mass of nothing."""

    mass: Any = hb.parameter(3.0)


class Plain(hb.NumpySystem):
    def constraints(self, t: Any, q: Any) -> Any:
        return np.array([q @ q - 1.0])


def weight(system: Any) -> Any:
    return system.mass * jnp.stack([0.0, -9.81])


class ReadBeside(hb.System):
    """A function beside the class reads ``mass``, a method ``forces``; the others are near no name."""

    mass: Any = hb.parameter(2.0)
    power_of: Any = hb.parameter(1.0)

    def forces(self) -> Any:
        return weight(self)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        return self.forces()

    def speed(self, v: Any) -> Any:
        return jnp.sqrt(v @ v)


@pytest.mark.parametrize(
    ("kind", "name"),
    [(Misspelt, "constraint"), (Shortened, "mass_matrix"), (Unread, "mass_matrix"), (Plain, "constraint")],
)
def test_a_name_that_nothing_reads_is_refused_with_the_right_one(kind: type, name: str):
    system = kind(force=lambda t, q, v: np.array([0.0, -9.81])) if kind is Plain else kind()
    given = hb.Problem(name="p", system=system, t_span=(0.0, 1.0), q0=[1.0, 0.0], v0=[0.0, 0.0])
    with pytest.raises(ProblemError, match=f"the protocol's name is {name}"):
        hb.solve(given, "hht", rtol=1e-4)
    found = check(given)
    assert not found.passed
    assert f"the protocol's name is {name}" in str(found)


@pytest.mark.parametrize("kind", [Parameter, ReadBeside])
def test_a_near_name_that_the_system_reads_is_its_own(kind: type):
    given = hb.Problem(name="p", system=kind(), t_span=(0.0, 1.0), q0=[0.0, 0.0], v0=[0.0, 0.0])
    found = hb.solve(given, "hht", rtol=1e-6)
    assert found.success
    np.testing.assert_allclose(found.v[-1, 1], -9.81 * (2.0 if kind is ReadBeside else 1.0), rtol=1e-6)


@pytest.mark.parametrize(("given", "meant"), [("constraints", "constraint"), ("mass", "mass_matrix")])
def test_an_unknown_keyword_of_a_numpy_system_is_refused_with_the_nearest_one(given: str, meant: str):
    with pytest.raises(TypeError, match=rf"does not know {given}; known: .* Did you mean {meant}\?"):
        hb.NumpySystem(force=lambda t, q, v: 0.0 * q, **{given: lambda t, q: q})


def varying(t: float, q: Any) -> list[float]:
    return [2.0 * (1.0 + q[0] ** 2), 2.0]


@pytest.mark.parametrize("system", [Parameter(), hb.NumpySystem(force=lambda t, q, v: [0.0, -19.62], mass_matrix=varying)])
@pytest.mark.parametrize("solver", ["hht", "cvode"])
def test_a_mass_function_may_return_its_diagonal(solver: str, system: Any):
    """Along q[0], (1 + x^2) x'' = 0: the velocity stays; along q[1] the weight falls."""
    given = hb.Problem(name="p", system=system, t_span=(0.0, 1.0), q0=[1.0, 0.0], v0=[1.0, 0.0])
    assert all(row.passed for row in check(given).rows if row.id in ("shape/mass_matrix", "mass/definite"))
    found = hb.solve(given, solver, rtol=1e-6)
    np.testing.assert_allclose(found.q[-1], [2.0, -9.81 / 2.0], rtol=1e-4)
