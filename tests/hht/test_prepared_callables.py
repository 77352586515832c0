"""What is prepared of a NumpySystem serves its next solves; what its functions refer to is asked for each time."""

import numpy as np
import pytest

import hhtbench as hb
from solvers.hht import HHT

START = (0.0, 0.2), [1.0, 0.0], [0.0, 0.0]
HOW = ({"step": 0.01}, {"rtol": 1e-4})


class Pendulum:
    """A rod, whose functions look at what may change; a second row that binds the angle can be asked for."""

    def __init__(self, gravity=9.81, rows=1, mass=(1.0, 1.0)):
        self.gravity, self.rows = gravity, rows
        self.system = hb.NumpySystem(force=self.force, constraint=self.constraint, mass_matrix=np.array(mass))

    def force(self, t, q, v):
        if self.gravity is None:
            raise ValueError("there is none")
        return np.array([0.0, -self.gravity])

    def constraint(self, t, q):
        return np.array([q @ q - 1.0, q[1]][: self.rows])


def solved(system, how):
    """Bits and counters."""
    found = HHT(system).solve(*START, **how)
    assert found.success, found.message
    return found.q.tobytes(), found.lam.tobytes(), found.counters


@pytest.mark.parametrize("how", HOW, ids=str)
def test_what_the_functions_refer_to_may_change_between_two_solves(how):
    changing = Pendulum()
    first = solved(changing.system, how)
    changing.gravity = 3.0
    assert solved(changing.system, how) == solved(Pendulum(gravity=3.0).system, how) != first
    changing.gravity = 9.81
    assert solved(changing.system, how) == first


def test_another_number_of_constraints_or_another_mass_is_a_new_preparation():
    changing, how = Pendulum(), {"step": 0.01}
    first = solved(changing.system, how)
    changing.rows = 2
    assert solved(changing.system, how) == solved(Pendulum(rows=2).system, how) != first
    changing.rows = 1
    object.__setattr__(changing.system, "mass_matrix", np.array([1.0, 3.0]))
    assert solved(changing.system, how) == solved(Pendulum(mass=(1.0, 3.0)).system, how)
