"""The functions of one system's steps as the loops take them: by address, machine code or callbacks into Python."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from hhtbench.lowering import Dynamics, Native, NotNative, compile_function, native, route_of
from hhtbench.lowering.caching import ById, Cache
from hhtbench.lowering.compile.coloured import Coloured
from hhtbench.lowering.dynamics.foreign import Callbacks, foreign
from hhtbench.lowering.dynamics.jax_dynamics import SMALL, matrix_free
from solvers._finite import inverse_mass_at
from solvers.hht.equations.coefficients import Method
from solvers.hht.equations.corrections import SMALL as SMALLEST
from solvers.hht.equations.corrections import (
    fresh_correction,
    lagged_correction_and_end,
    residual_and_end,
    state_after,
    state_size,
)
from solvers.hht.equations.discretise import step_residual, step_residual_and_ends, step_residual_and_matrix
from solvers.hht.equations.known import Layout
from solvers.hht.equations.local_error import CONTROL, REMEMBERED, levels, raw_errors
from solvers.hht.linear.analysis import Analysis, full, of_code, of_pattern
from solvers.hht.loops import memory as mem
from solvers.hht.loops.memory import Memory, Sizes, allocate
from solvers.hht.step.newton import NewtonOptions

LARGEST = 200  # unknowns of a step up to which machine code without loops pays
MATRIX_COST = 3.0, 6.0  # iterations that a new matrix costs: chains of 100 links, and of 1,000 and more
MANY = 100_000  # entries computed for it from which it is the latter: they do not fit into the nearer memories

_known = Cache(16)  # ordering a matrix takes a millisecond
_lock = threading.RLock()


Pair = tuple[int, int]  # addresses of a function and of its parameters


class Functions:
    """What the loops call for one method and system, with the analysis of Newton's matrix and the sizes of their memory."""

    analysis: Analysis
    newton: NewtonOptions
    in_python = False  #: whether all of them are functions in Python

    def __init__(self, dynamics: Dynamics, method: Method, layout: Layout) -> None:
        self.dynamics, self.layout = dynamics, layout
        self.method = replace(method, start="f0")  # the first step's a0 is the loop's affair
        self.newton = NewtonOptions()
        self._blank: Memory | None = None  #: without events, to be copied

    @property
    def callbacks(self) -> Callbacks | None:
        """Those that machine code calls for the system's own functions."""
        return getattr(self.dynamics, "callbacks", None)

    def codes(self, callbacks: Callbacks) -> dict[str, Pair]:
        """Addresses by name, but for those of :meth:`error_codes`."""
        raise NotImplementedError

    def error_codes(self, callbacks: Callbacks) -> dict[str, Pair]:
        """Addresses of what only error control needs."""
        raise NotImplementedError

    @property
    def given(self) -> tuple[int, ...]:
        """The shape of the step and the state before it, as one vector."""
        s = self.layout.structure
        return (Sizes(n=s.n, m=s.m, p=s.p, size=0, inverse_mass=s.n * s.n * (s.mass == "variable")).given,)

    @property
    def raw(self) -> tuple[tuple[int, ...], ...]:
        """The shapes of what the raw errors are made from."""
        s = self.layout.structure
        end = state_size(self.layout) + s.n * s.n * (s.mass == "variable")
        return (self.layout.size,), self.given, (len(CONTROL) + len(REMEMBERED) * s.n,), (end,)

    def memory(self, events: int, samples: int) -> Memory:
        """Room for the loops of one engine; no state is in it yet."""
        if events:
            return self._memory(events, samples)
        with _lock:
            self._blank = self._blank or self._memory(0, 0)
        z = Memory(self._blank.w.copy(), self._blank.i.copy())
        z.i[mem.BASE], z.i[mem.INTEGER_BASE] = z.w.ctypes.data, z.i.ctypes.data
        return z

    def _memory(self, events: int, samples: int) -> Memory:
        s, layout, analysis = self.layout.structure, self.layout, self.analysis
        sections = analysis.sections()
        sizes = Sizes(
            n=s.n,
            m=s.m,
            p=s.p,
            size=layout.size,
            inverse_mass=s.n * s.n if s.mass == "variable" else 0,
            **self.extra_sizes(),
            computed=analysis.slots.size,
            matrix=analysis.own,
            maps=analysis.rows.size - analysis.own,
            storage=analysis.storage,
            couplings=len(sections.get("outside", ())),
            inverse=analysis.inverse,
            sections=sections,
            events=events,
            samples=samples,
        )
        z = allocate(sizes)
        analysis.fill(z)
        offsets, at = {}, 0
        for name, length in layout.unknowns.items():
            offsets[name], at = at, at + length
        z.i[mem.O_R1 : mem.O_R1 + 5] = [offsets.get(name, -1) for name in ("R1", "lam0", "lam1", "Rk", "mu")]
        z.i[mem.CALLS_PYTHON] = self.in_python or self.callbacks is not None
        z.i[mem.NOISY] = self.newton.matrix_cost > 0.0
        return z

    def extra_sizes(self) -> dict[str, int]:
        """Sizes of sections that only machine code needs."""
        return {}


class MachineCode(Functions):
    """All of them are machine code.

    Raises
    ------
    NotNative
        One cannot be compiled.
    """

    def __init__(self, dynamics: Dynamics, method: Method, layout: Layout, linsolver: str) -> None:
        s = layout.structure
        variable = s.mass == "variable"
        self._inverse_mass = native(inverse_mass_at, dynamics, shapes=((), (s.n,))) if variable else None
        if self._inverse_mass is not None:
            known = np.flatnonzero(self._inverse_mass.constants).tolist()
            layout = replace(layout, inverse_places=tuple(sorted({*self._inverse_mass.varying.tolist(), *known})))
        super().__init__(dynamics, method, layout)
        static = self.method, layout
        x, options = (layout.size,), dict[str, Any](shapes=((layout.size,), self.given))
        early_matrix = native(step_residual_and_matrix, dynamics, *static, stage="early", **options)
        matrix = native(step_residual_and_matrix, dynamics, *static, compact=True, stage="late", **options)
        self.analysis = of_code(matrix, layout.size, s.n, linsolver, SMALLEST)
        function: Any = residual_and_end
        head, more = layout.size, tuple[Any, ...]()
        if self.analysis.kind == "inverse":  # corrections in the place of residual and matrix
            own = self.analysis.own
            flat = self.analysis.rows[own:] * layout.size + self.analysis.columns[own:] - layout.size**2
            more = (tuple(flat.tolist()),)
            early_matrix, matrix = (
                native(fresh_correction, dynamics, *static, *more, stage=stage, **options) for stage in ("early", "late")
            )
            function, head = lagged_correction_and_end, 2 * layout.size + 2
            options = {"shapes": (x, (layout.size**2,), (flat.size,), self.given)}
        end = head + state_size(layout)
        self._native = {
            "residual": native(function, dynamics, *static, *more, stage="late", rows=(0, head), **options),
            "matrix": matrix,
            "end": native(function, dynamics, *static, *more, stage="late", rows=(head, end), **options),
            "early": native(function, dynamics, *static, *more, stage="early", **options),
            "early_matrix": early_matrix,
        }
        if self._inverse_mass is not None:
            self._native["inverse_mass"] = self._inverse_mass
        self._of_error: dict[str, Native] = {}

    def codes(self, callbacks: Callbacks) -> dict[str, Pair]:
        """Addresses by name."""
        return {name: _pair(code) for name, code in self._native.items()}

    def error_codes(self, callbacks: Callbacks) -> dict[str, Pair]:
        """Addresses of what only error control needs; compiled here."""
        with _lock:  # they are shared between solvers, and these between threads
            if not self._of_error:
                s = self.layout.structure
                made = {"raw": native(raw_errors, self.dynamics, self.method, self.layout, shapes=self.raw)}
                if s.constrained:
                    made["levels"] = native(levels, self.dynamics, shapes=((), (s.n,), (s.n,)))
                self._of_error = made
        return {name: _pair(code) for name, code in self._of_error.items()}

    def extra_sizes(self) -> dict[str, int]:
        """Sizes of sections that only machine code needs."""
        sizes = {name: self._native[name].size for name in ("early", "early_matrix")}
        return sizes | ({"fresh": self._native["matrix"].size} if self.analysis.kind == "inverse" else {})


class PythonFunctions(Functions):
    """All of them are functions in Python: compiled by XLA, or a NumPy system's own."""

    in_python = True

    def __init__(self, dynamics: Dynamics, method: Method, layout: Layout, linsolver: str) -> None:
        super().__init__(dynamics, method, layout)
        static, size, s = (self.method, layout), layout.size, layout.structure
        source, entries = self._sparse(linsolver)
        self._source = source
        if entries is None:
            entries = compile_function(step_residual_and_matrix, dynamics, *static)
        one, x = self.given, (size,)
        computed = self.analysis.slots.size
        self._functions: dict[str, tuple[Callable[..., Any], int, tuple[Any, ...]]] = {
            "residual": (compile_function(step_residual, source, *static), size, (x, one, None)),
            "matrix": (entries, computed, (x, one, None)),
            "end": (compile_function(state_after, source, *static), state_size(layout), (x, one, None)),
        }
        if s.mass == "variable":
            inverse = compile_function(inverse_mass_at, dynamics)
            self._functions["inverse_mass"] = (lambda t, q: inverse(t, q).ravel()), s.n * s.n, ((), (s.n,))

    def _sparse(self, linsolver: str) -> tuple[Dynamics, Callable[..., Any] | None]:
        """The dynamics to compile, and [residual; entries] of a sparse matrix; None: of the full one.  Sets the analysis."""
        size, n, static = self.layout.size, self.layout.structure.n, (self.method, self.layout)
        small = linsolver == "dense" or (linsolver == "auto" and size < SMALL)
        reason = f"below {SMALL} unknowns"
        products = None if small else matrix_free(self.dynamics)
        if not small:
            reason = "its functions give full matrices (not a JAX system, a mass that is no diagonal, or rows left out)"
        if products is not None:
            try:
                example = np.zeros(size), np.zeros(self.given)
                coloured = Coloured(step_residual_and_ends, products, *static, example=example)
            except NotImplementedError as error:  # a primitive whose sparsity asdex does not know
                reason = f"the pattern of its derivatives cannot be read: {error}"
            else:
                self.analysis = of_pattern(coloured.pattern, size, linsolver)
                if self.analysis.kind != "dense":
                    computed = coloured.pattern.colours * coloured.pattern.shape[0]
                    self.newton = NewtonOptions(matrix_cost=MATRIX_COST[computed > MANY], max_iterations=25)
                    return products, lambda x, given: np.delete(coloured.packed(x, given), np.s_[size : size + 2 * n])
                reason = self.analysis.reason
        self.analysis = full(size, n, linsolver, reason)
        return self.dynamics, None

    def codes(self, callbacks: Callbacks) -> dict[str, Pair]:
        """Addresses by name."""
        return {name: (callbacks.entry(*function), 0) for name, function in self._functions.items()}

    def error_codes(self, callbacks: Callbacks) -> dict[str, Pair]:
        """Addresses of what only error control needs."""
        s = self.layout.structure
        raw = compile_function(raw_errors, self._source, self.method, self.layout)
        found = {"raw": (callbacks.entry(raw, 3 * s.n, self.raw), 0)}
        if s.constrained:
            rows = compile_function(levels, self._source)
            found["levels"] = callbacks.entry(rows, 2 * s.m + s.p, ((), (s.n,), (s.n,))), 0
        return found


def functions_for(dynamics: Dynamics, method: Method, linsolver: str, *, compiled: bool = True) -> Functions:
    """Those of a system, remembered for the same dynamics: machine code where that pays and is known how."""
    key = ById(dynamics), replace(method, start="f0"), linsolver, compiled
    return _known.find(key, lambda: _made(dynamics, method, linsolver, compiled))


def _made(dynamics: Dynamics, method: Method, linsolver: str, compiled: bool) -> Functions:
    layout = layout_of(dynamics, method)
    if compiled and layout.size <= LARGEST:
        try:
            return MachineCode(foreign(dynamics) if route_of(dynamics) == "numpy" else dynamics, method, layout, linsolver)
        except NotNative:
            pass
    return PythonFunctions(dynamics, method, layout, linsolver)


def layout_of(dynamics: Dynamics, method: Method) -> Layout:
    """The unknowns of ``method``'s steps."""
    moving = method.reaction in ("implicit", "midpoint")
    unknown = moving and (method.coefficients.b != 0.0 or dynamics.structure.mass == "variable")
    return Layout(dynamics.structure, moving, unknown)


def _pair(code: Native) -> Pair:
    return code.address, int(code.parameters.ctypes.data)
