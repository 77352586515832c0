"""What an evaluation costs, counted in operations: by hand, and as it grows."""

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.lowering import operations
from hhtbench.protocol.system import NumpySystem, System, parameter
from tests.lowering.systems import PENDULUM_NUMPY


class Sloping(System):
    """A point in the plane on a line through the origin, pulled by a spring."""

    k: float = parameter(3.0)
    a: float = parameter(0.6)
    b: float = parameter(0.8)

    def force(self, t, q, v):
        return jnp.array([self.k * q[0], 0.0])

    def constraint(self, t, q):
        return jnp.array([self.a * q[0] + self.b * q[1]])


class Free(Sloping):
    constraint = None


def counted(problem):
    return operations(problem.system, problem.t_span[0], problem.q0, problem.v0)


def test_operations_are_those_counted_by_hand():
    """Free: v' - F is k q and two differences, of which one has a zero; a division by each mass.

    On the line: a lam, b lam, two sums with them, and a v1' + b v2'.  Its matrix [1 0 a; 0 1 b; a b 0] is known; each of two
    pivots divides one entry and takes one product off one other; then L and U, and three pivots.
    """
    at = 0.0, np.zeros(2), np.zeros(2)
    free, line = operations(Free(), *at), operations(Sloping(), *at)
    residual = 1 + 1
    assert free == {"residual": residual, "acceleration": residual + 2}
    residual += 2 + 2 + 3
    factors, solve = 2 * (1 + 2), 2 * (2 + 2) + 3
    assert line == {"residual": residual, "acceleration": residual + factors + solve}


def test_a_linear_system_inside_a_force_counts_by_gauss():
    """Of three unknowns: two rows, then one, are divided and taken off; then three divisions and six products."""

    class Solved(System):
        inertia: object = parameter([[2.0, 0.3, 0.4], [0.3, 3.0, 0.5], [0.4, 0.5, 4.0]])

        def force(self, t, q, v):
            return jnp.linalg.solve(self.inertia, q)

    found = operations(Solved(), 0.0, np.zeros(3), np.zeros(3))
    elimination, solve, difference = 2 * (1 + 2 * 2) + 1 * (1 + 2 * 1), 3 + 2 * (3 + 3), 3
    assert found["residual"] == elimination + solve + difference


@pytest.mark.parametrize(("problem", "size", "order"), [("planar_chain(n_links={})", 20, 1), ("fekete(n_points={})", 20, 2)])
def test_operations_grow_as_the_mechanism_does(problem, size, order):
    """Chains by the link, whose matrix is banded; points that repel one another by their pairs."""
    small, large = (counted(hb.load_problem(problem.format(n))) for n in (size, 2 * size))
    for level in ("residual", "acceleration"):
        assert large[level] / small[level] == pytest.approx(2**order, rel=0.2)


def test_plain_callables_cannot_be_read():
    assert isinstance(PENDULUM_NUMPY, NumpySystem)
    assert operations(PENDULUM_NUMPY, 0.0, np.array([0.6, -0.8]), np.zeros(2)) is None


EVALUATED = {
    "residual": ("hht", "rattle", "ida(form=ggl)", "collocation", "minimal(solver=hht)"),
    "acceleration": ("cvode", "projected", "diffrax", "minimal(solver=cvode)"),
}


def test_solvers_say_what_they_evaluate():
    pendulum = hb.load_problem("simple_pendulum")
    for what, solvers in EVALUATED.items():
        for solver in solvers:
            found, of = hb.load_solver(solver).evaluates(pendulum)
            assert (found, of is pendulum) == (what, not solver.startswith("minimal")), solver
