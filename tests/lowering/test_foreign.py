"""Functions of a NumPy system are called back from machine code: same values, shared code, nothing raised is lost."""

import gc
import os
import signal
import threading

import numpy as np
import pytest

from hhtbench.lowering import derive, native
from hhtbench.lowering.dynamics.dynamics import as_declared
from hhtbench.lowering.dynamics.foreign import FUNCTIONS, foreign, functions_of
from hhtbench.lowering.scalar_compiler import native_call
from hhtbench.protocol.system import NumpySystem
from hhtbench.solution.result import Status
from solvers.hht import HHT
from tests.hht.scenes import Q0, V0, pendulum
from tests.lowering.native import native_pieces
from tests.lowering.systems import RICH_NUMPY, RUBBING_NUMPY
from tests.sample import slow


def arguments_of(name, structure, random):
    sizes = {"q": structure.n, "v": structure.n, "x": structure.n, "lam": structure.m, "mu": structure.p}
    return [
        0.3 if symbol == "t" else random.normal(size=sizes[symbol]) for symbol in functions_of(structure)[name].arguments
    ]


def called(dynamics, name, *arguments):
    return dynamics.xp.concatenate([part.ravel() for part in _parts(as_declared(dynamics, name)(*arguments))])


def _parts(value):
    return [part for part in value if part is not None] if isinstance(value, tuple) else [value]


FRICTION = ("force", "reaction", "reaction_jacobians")
CASES = [(RICH_NUMPY, 3, name) for name in FUNCTIONS] + [(RUBBING_NUMPY, 2, name) for name in FRICTION]


@pytest.mark.parametrize(("system", "n", "name"), CASES, ids=lambda x: "" if isinstance(x, NumpySystem) else x)
def test_machine_code_gets_what_the_function_gives(system, n, name):
    dynamics = derive(system, 0.0, np.ones(n), np.ones(n))
    random = np.random.default_rng(7)
    arguments = arguments_of(name, dynamics.structure, random)
    shapes = tuple(np.shape(argument) for argument in arguments)
    code = native(called, foreign(dynamics), name, shapes=shapes)
    expected = called(dynamics, name, *arguments)
    np.testing.assert_allclose(native_call(code, shapes)(*arguments), expected, rtol=1e-14, atol=1e-14)


def test_systems_of_one_structure_share_code_whatever_their_functions():
    for length in (1.0, 1.0, 2.0):
        before = native_pieces()
        circle = lambda t, q, radius=length: np.array([(q @ q - radius**2) / 2])  # noqa: E731
        solution = HHT(pendulum(constraint=circle)).solve((0.0, 0.1), length * Q0, V0, step=0.01)
        assert solution.success, solution.message
        np.testing.assert_allclose(np.sum(solution.q**2, axis=1), length**2, rtol=1e-13)
    assert native_pieces() == before


def test_a_function_that_raises_leaves_its_result_unset_and_its_exception_there():
    def broken(t, q, v):
        raise ZeroDivisionError("now")

    traced = foreign(derive(pendulum(), 0.0, Q0, V0))
    bad = foreign(derive(pendulum(force=broken), 0.0, Q0, V0))
    shapes = (), (2,), (2,)
    for dynamics, finite in ((traced, True), (bad, False)):
        value = native_call(native(called, dynamics, "force", shapes=shapes), shapes)(0.0, Q0, V0)
        assert np.isfinite(value).all() == finite
    assert isinstance(bad.callbacks.take_cause(), ZeroDivisionError)
    assert bad.callbacks.take_cause() is None


@pytest.mark.parametrize("count", [30, slow(100)])
def test_all_interrupts_are_reported(request, count):
    """Wherever they fall: in a callback, between two of its lines, in machine code or in Python around it.

    But for the garbage collector, whose hook of JAX's prints and forgets an interrupt that falls into it.
    """
    request.addfinalizer(gc.enable)
    gc.disable()
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # in the background it is ignored
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))
    random, told, calls, timers = np.random.default_rng(3), 0, [], []

    def force(t, q, v):
        calls.append(t)
        if len(calls) == 500:  # the steps have begun long since
            timers.append(threading.Timer(0.01 * random.random(), os.kill, (os.getpid(), signal.SIGINT)))
            timers[-1].start()
        return np.array([0.0, -9.81])

    solver = HHT(pendulum(force=force))
    for _ in range(count):
        calls.clear()
        try:
            solver.solve((0.0, 1e6), Q0, V0, step=0.001, max_seconds=20.0)
        except KeyboardInterrupt as error:
            told += 1
            partial = error.partial_solution
            assert partial.status is Status.interrupted
            assert np.isfinite(partial.q).all()
        timers.pop().join()
    assert told == count
    assert solver.solve((0.0, 0.1), Q0, V0, step=0.01).success
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
