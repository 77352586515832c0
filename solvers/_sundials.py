"""Common parts of the IDA and CVODE adapters (scikit-sundae): Newton's matrix, steps, capture of printed errors.

SUNDIALS writes warnings itself, in C, into the file that its environment variable names.  Errors come through
scikit-sundae, which calls Python's ``print`` in the thread that took the step.  Its compiled code refers to ``print``
itself, so only the stream can be intercepted.  ``sys.stdout`` is not replaced: of two threads that do so, one restores
the other's.
"""

from __future__ import annotations

import os
import re
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix

from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.printing import exact
from hhtbench.solution.result import Status
from solvers import forms
from solvers._dense import NODES, Polynomial
from solvers._run import Halt, Run

os.environ.setdefault("SUNLOGGER_WARNING_FILENAME", os.devnull)  # read when a solver is made; else it is stdout

LAPACK = 100  # unknowns from which LAPACK's blocked LU is faster than SUNDIALS' own
TOO_ACCURATE = -2
SUNDIALS_ENDS = {  # flags of IDA and CVODE with a Status; for others the library's message is shown
    -1: Status.max_steps,
    TOO_ACCURATE: Status.step_too_small,  # accuracy beyond roundoff was asked for
    -3: Status.step_too_small,
    -4: Status.newton_failed,
    -6: Status.singular_iteration_matrix,
    -7: Status.singular_iteration_matrix,
    -22: Status.declined,
}
PRINTED = re.compile(r"\n\[\w+, Error: -?\d+\] .*\n", re.DOTALL)  # by _sunerr_handler of sksundae/_cy_common.pyx


class SundialsMatrix:
    """Newton's matrix for SUNDIALS: the linear solver, and the Jacobian's values in the order that it expects."""

    def __init__(self, form: forms.Form) -> None:
        self._order: Any = ...
        self._options: dict[str, Any] = {"linsolver": "dense" if form.size < LAPACK else "lapackdense"}
        if form.pattern is not None:
            rows, columns = form.pattern.rows, form.pattern.columns
            self._order = np.lexsort((rows, columns))
            pattern = csc_matrix((np.ones(rows.size), (rows, columns)), shape=form.pattern.shape)
            self._options = {"linsolver": "sparse", "sparsity": pattern}

    def solver(self, library: Any, function: Any, **options: Any) -> Any:
        """Build an IDA or CVODE for this matrix."""
        if self._order is ...:
            return library(function, **self._options, **options)
        with warnings.catch_warnings():
            text = "Custom sparse Jacobian approximation will be ignored"  # as it should: the Jacobian is given
            warnings.filterwarnings("ignore", message=text)
            return library(function, **self._options, **options)

    def values(self, found: Vector | Matrix) -> Vector | Matrix:
        """Reorder a Jacobian of the form: the full matrix, or the entries of a pattern column by column."""
        return found[self._order]


def step_sundials(run: Run, solver: Any) -> None:
    """Take the steps of ``solver``, an IDA or CVODE of scikit-sundae after ``init_step``, until ``run.t1``."""
    with overheard() as said:
        while run.unfinished():
            step = solver.step(run.t1, method="onestep", tstop=run.t1)
            if step.status < 0:
                status = SUNDIALS_ENDS.get(int(step.status), Status.unreliable)
                text = _roundoff(run) if step.status == TOO_ACCURATE else status.text
                where = f"t = {exact(run.now)} was reached; the library's times count from {exact(run.time(run.t0))}."
                raise Halt(status, f"{step.message} {' '.join(said)} {text} {where}")
            dense = partial(_sampled, solver, run.t, step)
            run.accept(step.t, step.y, partial(_state, solver, step), partial(_rate, solver, step), dense=dense)


def _roundoff(run: Run) -> str:
    """Advice to loosen tolerances until the roundoff of y is less than half of what they allow."""
    size = np.sqrt(np.mean((run.y / (run.rtol * np.abs(run.y) + run.weights)) ** 2))
    below = 2 * np.finfo(np.float64).eps * size
    return f"Roundoff is reached: loosen the tolerances {below:.2g} times."


def _state(solver: Any, step: Any, time: float) -> Vector:
    """y at ``time`` within the last step."""
    return _within(solver, step.t, time).y


def _rate(solver: Any, step: Any, time: float) -> Vector:
    """y' at ``time`` within the last step of an IDA, or at its end."""
    return step.yp if time == step.t else _within(solver, step.t, time).yp


def _sampled(solver: Any, start: float, step: Any) -> Polynomial:
    """The library's polynomial over the last step, from ``start``, rebuilt from samples, since it keeps none."""
    times = start + (step.t - start) * NODES
    values = np.array([np.array(solver.step(time, method="normal", tstop=None).y) for time in times.tolist()])
    solver.step(step.t, method="normal", tstop=None)
    return Polynomial(times, values)


def _within(solver: Any, end: float, time: float) -> Any:
    """The library's state at ``time``; afterwards it is reset to the step's end, from where it continues."""
    found = solver.step(time, method="normal", tstop=None)
    solver.step(end, method="normal", tstop=None)
    return found


class _Here(threading.local):
    """Errors captured in one thread."""

    said: list[str] | None = None  #: texts captured; None: capture is off
    newline = False  #: ``print`` has yet to write the newline that ends a message


class _Ear:
    """Replaces the ``write`` of a stream while threads capture errors from it."""

    def __init__(self, stream: Any) -> None:
        self.write, self.listeners = stream.write, 0

    def __call__(self, text: str) -> Any:
        if _here.said is not None and PRINTED.fullmatch(text):
            _here.said.append(text.strip())
            _here.newline = True
            return len(text)
        ends, _here.newline = _here.newline and text == "\n", False
        return len(text) if ends else self.write(text)


_here = _Here()
_lock = threading.Lock()
_ears: dict[int, _Ear] = {}  # by id of the stream


@contextmanager
def overheard() -> Iterator[list[str]]:
    """Context in which errors printed by SUNDIALS in this thread are collected; other output passes through."""
    stream: Any = sys.stdout
    before, said = _here.said, list[str]()
    with _lock:
        if id(stream) not in _ears:
            _ears[id(stream)] = _Ear(stream)
            stream.write = _ears[id(stream)]
        _ears[id(stream)].listeners += 1
    _here.said = said
    try:
        yield said
    finally:
        _here.said = before
        with _lock:
            _ears[id(stream)].listeners -= 1
            if not _ears[id(stream)].listeners:  # with the last listener the stream is as it was
                del _ears[id(stream)], stream.write
