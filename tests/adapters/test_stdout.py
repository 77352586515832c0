"""What libraries print stays off the terminal and goes into the status; what anybody else prints stays where it was."""

import ctypes
import io
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stdout
from dataclasses import replace
from threading import Event

import numpy as np
import pytest

from hhtbench.solution.request import Request
from hhtbench.solution.result import Status
from solvers import cvode, ida
from tests.adapters.scenes import HOST, LOOSE, ON_HOST, numpy_ring

SUNDIALS = pytest.mark.parametrize("solver", [ida.solver(), cvode.solver()], ids=lambda solver: solver.name)
PATIENCE = 60.0  # [s] for a thread that never comes


def until(limit):
    return lambda t, q, v: np.array([0.0, 0.0 if t < limit else np.nan])


def failing():
    """IDA on index 3: how it fails hangs on roundoff, and plain callables give the same on every route."""
    return ida.solver(form="index3").solve(numpy_ring(), Request(rtol=2e-8, max_seconds=20.0))


def test_nothing_of_a_library_is_printed(capfd):
    for solver in HOST:
        solver.solve(numpy_ring(force=until(0.5)), LOOSE)
    failed = failing()
    assert failed.status in (Status.newton_failed, Status.step_too_small)
    assert "Error: " in failed.message, "what IDA prints goes into the message"
    assert capfd.readouterr() == ("", "")


@ON_HOST
def test_nothing_of_a_library_is_printed_where_times_do_not_resolve_its_steps(solver, capfd):
    """SUNDIALS warns of that in C, past ``sys.stdout``."""
    pendulum = numpy_ring(force=lambda t, q, v: np.array([0.0, -9.81]))
    for t0 in (1e12, 1e15):
        solver.solve(replace(pendulum, t_span=(t0, t0 + 1.0)), Request(rtol=1e-8, max_seconds=20.0))
    ctypes.CDLL(None).fflush(None)  # C keeps its own buffer
    assert capfd.readouterr() == ("", "")


def test_what_a_callback_prints_is_passed_on(capfd):
    calls = []

    def force(t, q, v):
        calls.append(t)
        sys.stdout.write("here\n")
        return np.zeros(2)

    ida.solver().solve(numpy_ring(force=force), LOOSE)
    assert capfd.readouterr().out == "here\n" * len(calls)


def overlapping(solver):
    """One solve that ends while another, begun after it, goes on."""
    first_began, second_began, first_ended = Event(), Event(), Event()

    def scene(began, awaited):
        def force(t, q, v):
            if t > 0:  # within the steps
                began.set()
                assert awaited.wait(PATIENCE)
            return np.zeros(2)

        return numpy_ring(force=force)

    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(solver.solve, scene(first_began, second_began), LOOSE)
        assert first_began.wait(PATIENCE)
        second = pool.submit(solver.solve, scene(second_began, first_ended), LOOSE)
        assert first.result(PATIENCE).success
        sys.stdout.write("between\n")
        first_ended.set()
        assert second.result(PATIENCE).success


@SUNDIALS
def test_overlapping_threads_leave_stdout_as_it_was(solver, capsys):
    stream, own = sys.stdout, dict(vars(sys.stdout))
    overlapping(solver)
    assert sys.stdout is stream
    assert vars(stream) == own
    assert capsys.readouterr().out == "between\n"


def test_a_solve_leaves_a_stream_alone_that_another_thread_puts_in_place_meanwhile():
    stream, buffer = sys.stdout, io.StringIO()
    with ThreadPoolExecutor(1) as pool:
        began, go_on = Event(), Event()

        def force(t, q, v):
            if t > 0:
                began.set()
                assert go_on.wait(PATIENCE)
            return np.zeros(2)

        running = pool.submit(ida.solver().solve, numpy_ring(force=force), LOOSE)
        assert began.wait(PATIENCE)
        with redirect_stdout(buffer):
            go_on.set()
            running.result(PATIENCE)
            sys.stdout.write("mine")
    assert sys.stdout is stream and "write" not in vars(stream)
    assert buffer.getvalue() == "mine"


def test_a_message_goes_to_the_thread_whose_solve_failed_and_the_others_print_on(capsys):
    def force(t, q, v):
        if t > 0 and not failed:
            failed.append(pool.submit(failing).result(PATIENCE))
            sys.stdout.write("still here\n")
        return np.zeros(2)

    failed = []
    with ThreadPoolExecutor(1) as pool:
        fine = ida.solver().solve(numpy_ring(force=force), LOOSE)
    assert "Error: " in failed[0].message
    assert fine.success and "Error: " not in fine.message
    assert capsys.readouterr().out == "still here\n"
