"""What is prepared of a NumpySystem serves its next solves; what its functions refer to is asked for each time."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import hhtbench as hb
from solvers.hht import HHT
from solvers.hht.run import functions, idle

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
def test_a_second_solve_prepares_nothing_and_goes_as_the_first(how, monkeypatch):
    system = Pendulum().system
    first = solved(system, how)
    made = []
    make = functions._made
    monkeypatch.setattr(functions, "_made", lambda *of: made.append(of) or make(*of))
    assert solved(system, how) == first
    assert not made


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


def test_an_exception_in_one_solve_is_not_seen_by_the_next():
    failing, how = Pendulum(), {"step": 0.01}
    first = solved(failing.system, how)
    failing.gravity = None
    with pytest.raises(ValueError, match="there is none"):
        solved(failing.system, how)
    failing.gravity = 9.81
    assert solved(failing.system, how) == first


def test_solves_of_one_system_at_once_do_not_mix():
    """Each counts its own callbacks, also of one that is solved in another's callback."""
    system = Pendulum().system
    alone = solved(system, HOW[0])
    with ThreadPoolExecutor(4) as pool:
        assert set(pool.map(lambda _: solved(system, HOW[0]), range(12))) == {alone}
    inner = []
    outer = hb.NumpySystem(force=lambda t, q, v: inner.append(solved(system, HOW[0])) or -q)
    found = HHT(outer).solve((0.0, 0.1), [1.0], [0.0], step=0.05)
    assert set(inner) == {alone}
    assert found.counters.residual_evaluations == len(inner)


def test_engines_with_plain_callables_wait_for_their_next_solve():
    system = Pendulum().system
    solved(system, HOW[0])
    assert any(engine.dynamics.system is system for _, engine in idle._idle)


def test_a_solve_within_a_callback_of_the_same_system_has_functions_of_its_own(monkeypatch):
    """What one of them has raised is noted with them."""
    made, inner, make = [], [], functions._made

    def force(t, q, v):
        if len(made) == 1 and not inner:
            inner.append(None)
            inner[0] = solved(system, HOW[0])
        return -q

    monkeypatch.setattr(functions, "_made", lambda *of: made.append(make(*of)) or made[-1])
    system = hb.NumpySystem(force=force)
    assert solved(system, HOW[0]) == inner[0] == solved(system, HOW[0])
    assert len(made) == 2
    assert made[0].callbacks is not made[1].callbacks
