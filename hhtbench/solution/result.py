"""What a solver returns: status, counters, trajectory."""

from __future__ import annotations

import enum
import html
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.printing import exact
from hhtbench.solution.filled import Filled

if TYPE_CHECKING:
    from hhtbench.solution.phases import Impact, Phase

ROWS = ("q", "v", "lam", "mu")  #: arrays of a solution with one row per time
OF_FUNCTIONS = ("interpolant", "projection", "drift_of", "judge_of", "diagnosis_of")  #: its fields that call functions
NOT_KEPT = (*OF_FUNCTIONS, "file")  #: its fields that a file does not hold


class Status(enum.Enum):
    """How a solve ended: one vocabulary for every solver.

    ``code`` is SUNDIALS' integer where it has the same outcome, else None; ``text`` says what to do.
    """

    success = (0, "The end of the interval was reached.")
    event = (2, "A terminal event stopped the integration; continue from the returned state.")
    max_steps = (-1, "The step budget is used up; raise max_num_steps or loosen the request.")
    step_too_small = (
        -3,
        "Only steps too short to arrive are accepted; loosen the tolerances or look for a jump in the forces; "
        "`hhtbench check` finds negative masses and wrong derivatives.",
    )
    newton_failed = (
        -4,
        "Newton's iteration did not converge; take a smaller step, look for a jump, check derivatives by `hhtbench check`.",
    )
    singular_iteration_matrix = (
        -6,
        "The matrix of the step is singular; see the message for the rank and `hhtbench check` for the rows.",
    )
    redundant_constraints = (None, "Rows of the constraint Jacobian are dependent; remove the rows named in the message.")
    nonfinite_callback = (-8, "A function of the system returned NaN or infinity; the message names it.")
    inconsistent_initial = (
        None,
        "The start violates the constraints; the message names the rows. Correct q0, v0 or pass calc_initcond=True.",
    )
    time_resolution = (
        None,
        "The step is below the spacing of floating-point times; shift the time origin or take longer steps.",
    )
    evaluation_budget = (None, "The budget of evaluations is used up; raise max_evaluations.")
    deadline = (None, "The time budget is used up; raise max_seconds.")
    accuracy_not_shown = (None, "Runs do not show that the error is as small as asked; the message says what is known.")
    interrupted = (None, "The solve was interrupted from outside.")
    declined = (-22, "The solver cannot take this problem or request; the message says why.")
    unreliable = (None, "The library reported success but its result failed the check.")
    user_exception = (None, "A function of the system raised an exception.")
    crashed = (None, "The worker process died.")
    out_of_memory = (None, "The worker process ran out of memory.")

    def __init__(self, code: int | None, text: str) -> None:
        self.code = code
        self.text = text

    @property
    def label(self) -> str:
        """Name of the status in tables and files."""
        return self.name


@dataclass(frozen=True, kw_only=True)
class Counters(Filled):
    """Work done; None means not reported, never zero instead.

    One residual evaluation is one point (t, q, v) at which F, or another function for a finite difference, is evaluated.
    ``output_evaluations`` are those for output rows: their multipliers, rows inside a step, projection onto the constraints
    (one each; none where the functions are in Python).  No other counter contains them, so that work does not depend on the
    number of output rows.  Budgets of evaluations do not end the computation of output.
    ``provenance`` states the origin of the counters: counted (by our wrapper), library, or not reported.
    """

    steps_accepted: int | None = 0
    steps_rejected_error: int | None = 0
    steps_rejected_newton: int | None = 0
    newton_iterations: int | None = 0
    residual_evaluations: int | None = 0
    output_evaluations: int | None = 0
    jacobian_evaluations: int | None = 0
    factorisations: int | None = 0
    linear_solves: int | None = 0
    event_evaluations: int | None = 0
    nonfinite_evaluations: int | None = 0
    provenance: str = "counted"


_COUNTED = [counter.name for counter in fields(Counters) if counter.name != "provenance"]
NOT_REPORTED = Counters(**dict.fromkeys(_COUNTED), provenance="not reported")


@dataclass(frozen=True, kw_only=True)
class StepsData:
    """Stage values of the HHT method, one row per accepted step."""

    t: Vector  #: (N,) end times of the steps [s]
    h: Vector  #: (N,) signed lengths [s]
    a: Matrix  #: (N, n) auxiliary accelerations at the end of the step, near f(t + alpha h)
    lam_start: Matrix  #: (N, m) multiplier of the reaction at the start of the step, first order
    lam_end: Matrix  #: (N, m) the same at its end (or midpoint), first order
    mu_half: Matrix  #: (N, p) multiplier of the velocity constraints at the midpoint


@dataclass(frozen=True, kw_only=True)
class Ends:
    """States at the start and at the end of every accepted step."""

    t: Vector  #: (k,) [s]
    q: Matrix  #: (k, n)
    v: Matrix  #: (k, n)
    carried: Mapping[str, Matrix] | None = None  #: as that of :class:`Solution`


class DenseOutput(NamedTuple):
    """Interpolated state: ``q, v`` (n,) at one time, (k, n) at k times."""

    q: Matrix
    v: Matrix


@dataclass(frozen=True, kw_only=True)
class ErrorEstimate:
    """Estimated error of the finest of several runs of a solver at finer settings, scaled by the problem's scales.

    NaN, and ``bound`` None, where it is not known.
    """

    asked: float  #: the error asked for, of q and v
    bound: float | None  #: bound of the largest error of q and v over the output times
    q: Vector  #: (n_t,) estimated error at every output time, largest component
    v: Vector  #: (n_t,)
    lam: Vector  #: (n_t,) the same of the multipliers, which ``bound`` does not cover
    differences: tuple[float, ...]  #: largest, between each run and the next
    settings: tuple[float, ...]  #: tolerances of the runs, or numbers of steps

    def __repr__(self) -> str:
        bound = "not known" if self.bound is None else f"{self.bound:.2g}"
        return f"<ErrorEstimate: asked {self.asked:g}, bound {bound}, {len(self.settings)} runs, rows in .q, .v and .lam>"


@dataclass(frozen=True, kw_only=True)
class Solution(Filled):
    """A trajectory, time first; ``lam`` and ``mu`` are recovered from the acceleration level.

    A solver that reports no work leaves every counter None.

    ``carried`` is None if the solver has no multipliers of its own (on the underlying ODE) and for HHT with output between
    its steps, since its stage values belong to the ends of steps.  ``steps_data`` and ``interpolant`` are None if only rows
    at ``t_eval`` were asked for and the steps were too many to store.
    """

    t: Vector  #: (n_t,) [s]
    q: Matrix  #: (n_t, n)
    v: Matrix  #: (n_t, n)
    lam: Matrix  #: (n_t, m) multipliers of the position constraints
    mu: Matrix  #: (n_t, p) multipliers of the velocity constraints
    status: Status
    message: str  #: outcome, place and advice
    counters: Counters = field(default_factory=lambda: NOT_REPORTED)
    steps_data: StepsData | None = field(default_factory=lambda: None)  #: HHT only, made when it is read
    carried: Mapping[str, Matrix] | None = None  #: multipliers the solver itself holds: "lam" (n_t, m), "mu" (n_t, p)
    ends: Ends | None = None  #: where ``keep_steps`` asked for them; None for HHT, whose ``interpolant`` has them
    t_events: tuple[Vector, ...] = ()  #: times of the events [s], (k,) for each event function asked for
    q_events: tuple[Matrix, ...] = ()  #: (k, n) at those times, before what an event changes
    v_events: tuple[Matrix, ...] = ()  #: (k, n) the same
    #: where events changed the system; columns of ``lam`` and ``mu`` that a phase's system does not have are zero in it
    phases: tuple[Phase, ...] = ()
    impacts: tuple[Impact, ...] = ()  #: of events with ``restitution`` or ``then``
    layout: Any = None  #: of states and inputs in ``v`` and ``q``, where the problem has some
    #: dense output over the accepted steps
    interpolant: Callable[[Any], DenseOutput] | None = field(default_factory=lambda: None)
    #: projects dense output onto the constraints; not pickled
    projection: Callable[[Any, DenseOutput], DenseOutput] | None = field(default_factory=lambda: None)
    drift_of: Callable[[Solution], Any] | None = None  #: called by :meth:`drift`, set by ``hb.solve``; not pickled
    diagnosis_of: Callable[[], str] | None = None  #: called by :meth:`diagnose`, set by the solver; not pickled
    judge_of: Callable[..., Any] | None = None  #: called by :meth:`verify`, set by ``hb.solve``; not pickled
    file: str = ""  #: the file that :meth:`load` read, or ""
    error: ErrorEstimate | None = None  #: error estimate of a solve with ``accuracy``
    extrapolated: DenseOutput | None = None  #: Richardson extrapolation at ``t``, if three runs confirm it

    @property
    def success(self) -> bool:
        """True when the interval's end (or a terminal event) was reached."""
        return self.status in (Status.success, Status.event)

    @property
    def x(self) -> Matrix:
        """(n_t, k) first-order states; (n_t, 0) of a problem without."""
        return self.v[:, :0] if self.layout is None else np.asarray(self.layout.x(self.v))

    @property
    def u(self) -> Matrix:
        """(n_t, l) sampled inputs; (n_t, 0) of a problem without."""
        return self.q[:, :0] if self.layout is None else np.asarray(self.layout.u(self.q))

    @property
    def unknown(self) -> NDArray[np.bool_]:
        """(n_t,) True at rows with a NaN multiplier, one that does not exist or is not known."""
        return np.asarray(np.isnan(self.lam).any(axis=1) | np.isnan(self.mu).any(axis=1))

    def __call__(self, t: Any, *, project: bool = False) -> DenseOutput:
        """Evaluate the dense output at ``t``: scalar -> (n,) arrays, (k,) -> (k, n) arrays.

        ``project=True`` projects q and v onto the constraints on both levels, which the interpolant meets only up to its
        error; a state that cannot be projected is returned as it is, with a warning.
        """
        if self.interpolant is None and self.file:
            raise ValueError(f"{self.file} holds no dense output: save one with rows at the times wanted (t_eval=...).")
        if self.interpolant is None:
            raise ValueError(
                "this solution has no dense output: no step was accepted, the solver is a library's that was not asked "
                "for it (dense_output=True), its events are found between the steps (give t_eval), or with t_eval there "
                "were more steps than it keeps (keep_steps=True: all)."
            )
        found = self.interpolant(t)
        if not project:
            return found
        if self.projection is None:
            raise ValueError("project=True needs the system's functions: this solution is of a pickle, or joined at events.")
        return self.projection(t, found)

    def drift(self) -> Any:
        """Measure the drift off constraints, energy and invariants: a :class:`hhtbench.checks.drift.Drift`.

        Taken over the internal steps where they are known, else over the rows; None without rows.
        """
        if self.drift_of is None:
            raise ValueError(
                "this solution came without its problem's functions, as from a file or a pickle; give the problem: "
                "hhtbench.measure_drift(problem, solution)."
            )
        return self.drift_of(self)

    def diagnose(self) -> str:
        """Search for the cause of a failed run and return it as text; empty string if none is found or after a success.

        Only HHT's solutions can be diagnosed, and only with the system's functions (not after unpickling); others give "".
        The search covers functions that are not deterministic and vibrations that the last step cannot resolve.
        """
        if self.success or self.diagnosis_of is None:
            return ""
        return self.diagnosis_of()

    def verify(self, *, draw: int = 0) -> Any:
        """Check the solution as campaigns do; returns a :class:`hhtbench.checks.result.judge.Judgement`.

        Short windows are integrated again by an independent method that shares no code with any solver; this takes
        milliseconds to seconds.  ``doubt`` of the result states the objection, or is empty; ``draw`` selects the rows at
        which some windows begin.
        """
        if not self.success:
            raise ValueError(f"only a success is verified, and this run ended as {self.status.label}: {self.message}")
        if self.judge_of is None:
            raise ValueError(
                "this solution came without its problem and request, as from a file or a pickle; give them: "
                "from hhtbench.checks.result.judge import judge; judge(problem, hhtbench.Request(rtol=...), solution)."
            )
        return self.judge_of(self, draw=draw)

    def plot(self) -> Any:
        """Return a Matplotlib figure over time: coordinates, velocities, multipliers, estimated error, drift and energy.

        Drift is drawn after ``hb.solve``, not after :meth:`load` or unpickling: it needs the problem's functions.
        """
        from hhtbench.solution.plotting import plot_solution

        return plot_solution(self, None if self.drift_of is None else self.drift_of(self))

    def to_pandas(self) -> Any:
        """A pandas data frame, one row per time: ``t``, ``q[0]`` ..., ``v[0]`` ..., ``x[0]`` ..., ``u[0]`` ..., ``lam[0]``
        ..., ``mu[0]`` ....
        """
        try:
            from pandas import DataFrame
        except ModuleNotFoundError as missing:
            raise ModuleNotFoundError("to_pandas needs pandas: pip install 'hhtbench[pandas]'.") from missing
        n = self.q.shape[1] if self.layout is None else self.layout.n
        arrays = {"q": self.q[:, :n], "v": self.v[:, :n], "x": self.x, "u": self.u, "lam": self.lam, "mu": self.mu}
        columns = {f"{name}[{i}]": column for name, rows in arrays.items() for i, column in enumerate(rows.T)}
        return DataFrame({"t": self.t, **columns})

    def save(self, path: str | Path) -> Path:
        """Write the solution without its functions (dense output, :meth:`drift`) to an ``.npz`` file; returns its path."""
        from hhtbench.solution.saved import write_arrays

        kept = self.__getstate__()
        return write_arrays(path, {name: kept[name] for name in _KEPT})

    @classmethod
    def load(cls, path: str | Path) -> Solution:
        """Read a file of :meth:`save`; the solution has no dense output, drift is ``hhtbench.measure_drift(problem,
        solution)``.

        Raises ``ProblemError`` if the file is no saved solution.
        """
        from hhtbench.protocol.extended import Layout
        from hhtbench.solution.phases import Impact, Phase
        from hhtbench.solution.saved import read_arrays

        known = Status, Counters, StepsData, Ends, Impact, Phase, ErrorEstimate, DenseOutput, Layout
        found = read_arrays(path, known)
        rows = [found.get(name) for name in ("t", *ROWS)]
        shapes = [x.shape[:1] for x in rows if isinstance(x, np.ndarray) and x.dtype == np.float64]
        typed = isinstance(found.get("status"), Status) and isinstance(found.get("message"), str)
        if not typed or len(shapes) < len(rows) or len(set(shapes)) > 1 or set(found) != set(_KEPT):
            raise ProblemError(f"{path} is no saved solution: {', '.join(_KEPT)} do not fit one another.")
        return cls(**found, file=str(path))

    def __getstate__(self) -> dict[str, Any]:
        none = {"drift_of": None, "judge_of": None, "diagnosis_of": None}
        return super().__getstate__() | none | {"phases": tuple(replace(phase, system=None) for phase in self.phases)}

    def _repr_html_(self) -> str:
        rows = [f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in self._printed()]
        return f"<table style='text-align:left'>{''.join(rows)}</table>"

    def __repr__(self) -> str:
        rows = self._printed()
        width = max(len(name) for name, _ in rows)
        return "\n".join(f"{name:>{width}}: {value}" for name, value in rows)

    def _printed(self) -> list[tuple[str, str]]:
        """Return the names and values that ``repr`` prints."""
        rows = [("status", f"{self.status.label}: {self.message}"), ("t", _span(self.t))]
        rows += [(name, f"array {getattr(self, name).shape}") for name in ("q", "v", "lam", "mu")]
        if self.t_events:
            rows.append(("t_events", f"{', '.join(str(np.size(t)) for t in self.t_events)} events"))
        counted = [(f.name, getattr(self.counters, f.name)) for f in fields(self.counters)]
        return rows + [(name, "not reported" if value is None else str(value)) for name, value in counted]


def ends_of(solution: Solution) -> Ends | None:
    """Return the states at the ends of the steps, from ``solution.ends`` or its dense output; None if it has neither."""
    if solution.ends is not None:
        return solution.ends
    t: Any = getattr(solution.interpolant, "t", ())
    if not np.size(t):
        return None
    at = solution(np.asarray(t, dtype=np.float64))
    return Ends(t=np.asarray(t, dtype=np.float64), q=at.q, v=at.v)


_KEPT = [f.name for f in fields(Solution) if f.name not in NOT_KEPT]  # in a file


def _span(t: Vector) -> str:
    return f"{exact(t[0])} ... {exact(t[-1])} ({np.size(t)} rows)" if np.size(t) else "no rows"
