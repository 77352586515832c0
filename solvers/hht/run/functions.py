"""Functions of one system's steps for the compiled loops: addresses of machine code or of callbacks into Python."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from itertools import accumulate
from typing import Any

import numpy as np

from hhtbench.lowering import Dynamics, Native, NotNative, compile_function, native, route_of
from hhtbench.lowering.caching import Cache, by_id
from hhtbench.lowering.compile.coloured import MAX_COMPUTED, Coloured, find_pattern
from hhtbench.lowering.compile.routes import too_large
from hhtbench.lowering.dynamics.callbacks import Callbacks
from hhtbench.lowering.dynamics.dynamics import innermost
from hhtbench.lowering.dynamics.foreign import foreign
from hhtbench.lowering.dynamics.foreign_products import ForeignProducts, foreign_products
from hhtbench.lowering.dynamics.matrix_free import SMALL, MatrixFree
from hhtbench.lowering.dynamics.products import matrix_free
from solvers._finite import inverse_mass_at
from solvers.hht.equations.coefficients import Method
from solvers.hht.equations.corrections import SMALL as SMALLEST
from solvers.hht.equations.corrections import (
    constraint_residual,
    fresh_correction,
    residual_and_end,
    residual_and_entries,
    residual_of,
    state_after,
    state_size,
    stored_correction_and_end,
)
from solvers.hht.equations.known import Layout
from solvers.hht.equations.local_error import REMEMBERED, answer, raw_errors, scaled_inertia
from solvers.hht.equations.methods import equations_of
from solvers.hht.step.newton import NewtonOptions
from solvers.kernel import memory as mem
from solvers.kernel.full import level_functions
from solvers.kernel.kkt import levels
from solvers.kernel.linear.analysis import Analysis, full, of_code, of_pattern
from solvers.kernel.memory import CONTROL_NUMBERS, Memory, Sizes, copied

MAX_FULL = 200  # unknowns of a step up to which full matrices are used, even if they are sparse
FEW = 40  # unknowns of a step up to which M^-1, where it fills, costs less than accelerations as further unknowns
MAX_NATIVE = 200_000  # unknowns of a step up to which it is machine code: the graph then has ten million nodes
SPARSE = NewtonOptions(max_iterations=25)
MAX_COPIED = 200  # unknowns up to which a blank memory is kept and copied, in a tenth of the time
NOISE_MARGIN = 8.0  # Newton's tolerance over the error of reactions by differences
FULL = "its matrices are full (a NumPy system without patterns, a mass that fills or is singular, or without=zeros)"

_known = Cache(16)  # ordering a matrix takes a millisecond
_lock = threading.RLock()

Pair = tuple[int, int]  # addresses of a function and of its parameters
Code = Native | tuple[Callable[..., Any], int, tuple[Any, ...]]  # machine code, or (Python function, result size, shapes)


class Functions:
    """The functions that the loops call for one method and system, the matrix analysis, and the memory's sizes."""

    analysis: Analysis
    newton: NewtonOptions
    in_python = False  #: True if all are Python functions
    alone = False  #: True if none is or calls a Python function

    def __init__(self, dynamics: Dynamics, method: Method, layout: Layout) -> None:
        self.dynamics, self.layout = dynamics, layout
        self.method = replace(method, start="f0")  # the loop computes the first step's a0
        options = NewtonOptions()
        self.newton = replace(options, tolerance=max(options.tolerance, NOISE_MARGIN * innermost(dynamics).noise))
        self._sizes = memory_sizes(layout)
        self.given = (Sizes(**self._sizes, size=0).given,)  #: shape of the vector of step and state before it
        self._codes: dict[str, Code] = {}
        self._of_error: dict[str, Code] = {}
        self._blank: Memory | None = None  #: without events, to be copied

    @property
    def _moved_force(self) -> bool:
        """True if applied forces depend on q, (H59)."""
        return self.layout.structure.force_uses_q or self.layout.extrapolated

    @property
    def callbacks(self) -> Callbacks | None:
        """Callbacks by which machine code calls the system's own functions; None if it calls none."""
        return getattr(self.dynamics, "callbacks", None)

    def made(self, function: Callable[..., Any], size: int, shapes: tuple[Any, ...], *static: Any) -> Code:
        """Build ``function(dynamics, *static, ...)``, which returns ``size`` numbers from arrays of ``shapes``."""
        raise NotImplementedError

    def codes(self, callbacks: Callbacks) -> dict[str, Pair]:
        """Addresses of all functions by name, except those of :meth:`error_codes`."""
        return {name: _pair(code, callbacks) for name, code in self._codes.items()}

    def error_codes(self, callbacks: Callbacks) -> dict[str, Pair]:
        """Addresses of functions that only error control needs; compiled on first use."""
        with _lock:  # functions are shared between solvers, and solvers may run in several threads
            if not self._of_error:
                s, end = self.layout.structure, state_size(self.layout) + self._sizes["inverse_mass"]
                raw = (self.layout.size,), self.given, (len(CONTROL_NUMBERS) + len(REMEMBERED) * s.n,), (end,)
                codes = {"raw": self.made(raw_errors, 3 * s.n, raw, self.method, self.layout)}
                if self._moved_force:
                    codes["answer"] = self.made(answer, s.n, ((s.n,), self.given, (end,)), self.method, self.layout)
                if s.constrained:
                    codes["levels"] = self.made(levels, 2 * s.m + s.p, ((), (s.n,), (s.n,)))
                if s.mass == "sparse":
                    codes["inertia"] = self.made(scaled_inertia, s.n, ((s.n,), self.given), self.layout)
                self._of_error = codes  # all of them, or none where the time budget ends in between
        return {name: _pair(code, callbacks) for name, code in self._of_error.items()}

    def level_codes(self) -> dict[str, Pair]:
        """Addresses of functions for the start and the acceleration level, if these are machine code; compiled here."""
        return {}

    def memory(self, events: int, samples: int) -> Memory:
        """Memory for the loops of one engine, without a state."""
        if events or self.layout.size > MAX_COPIED:
            return self._memory(events, samples)
        self._blank = self._blank or self._memory(0, 0)
        return copied(self._blank)

    def _memory(self, events: int, samples: int) -> Memory:
        z = self.analysis.memory(**self._sizes, computed=self.analysis.targets.size, events=events, samples=samples)
        sizes = self.layout.unknowns
        starts = dict(zip(sizes, accumulate(sizes.values(), initial=0), strict=False))
        z.i[mem.O_R0 : mem.O_R0 + 6] = [starts.get(name, -1) for name in ("R0", "R1", "lam0", "lam1", "Rk", "mu")]
        z.i[mem.CALLS_PYTHON] = self.in_python or self.callbacks is not None
        z.i[mem.NOISY] = self.newton.matrix_cost > 0.0
        z.i[mem.LINEAR] = self.layout.structure.linear_reaction
        z.i[mem.STIFF_FORCES] = self._moved_force or self.layout.structure.force_uses_v
        return z


class MachineCode(Functions):
    """Functions that are all machine code.

    Raises
    ------
    NotNative
        One cannot be compiled.
    """

    def __init__(self, dynamics: Dynamics, method: Method, layout: Layout, linsolver: str) -> None:
        place, more = ((), (layout.structure.n,)), tuple[Any, ...]()
        variable = layout.structure.mass == "variable"
        inverse_mass = {"inverse_mass": native(inverse_mass_at, dynamics, shapes=place)} if variable else {}
        for code in inverse_mass.values() if layout.structure.known_entries else ():
            known = np.flatnonzero(code.constants).tolist()
            layout = replace(layout, inverse_places=tuple(sorted({*code.varying.tolist(), *known})))
        super().__init__(dynamics, method, layout)
        static, size = (self.method, layout), layout.size
        options: dict[str, Any] = {"shapes": ((size,), (1 + size,), self.given)}
        self.alone = self.callbacks is None
        early_matrix, matrix = self._matrix(linsolver, options)
        if self.analysis.kind == "inverse":  # corrections in the place of residual and matrix
            own = self.analysis.own
            flat = self.analysis.rows[own:] * size + self.analysis.columns[own:] - size**2
            more = (tuple(flat.tolist()),)
            early_matrix, matrix = (
                native(fresh_correction, dynamics, *static, *more, stage=stage, **options) for stage in ("early", "late")
            )
            self._sizes["fresh"] = matrix.size
            function: Any = stored_correction_and_end
            heads = 2 * size + 2, 3 * size + 4
            options = {"shapes": ((size,), (size**2,), (flat.size,), self.given)}
        else:
            function, heads, options = residual_and_end, (size, 2 * size), {"shapes": ((size,), self.given)}
        end = heads[1] + state_size(layout)
        early = native(function, dynamics, *static, *more, stage="early", **options)
        s = layout.structure
        self._sizes |= {"early": early.size, "early_matrix": early_matrix.size}
        self._sizes["level"] = s.n + s.m + s.p if self._starts_alone() else 0
        self._codes = {
            "residual": native(function, dynamics, *static, *more, stage="late", rows=(0, heads[0]), **options),
            "constraints": native(function, dynamics, *static, *more, stage="late", rows=heads, **options),
            "matrix": matrix,
            "end": native(function, dynamics, *static, *more, stage="late", rows=(heads[1], end), **options),
            "early": early,
            "early_matrix": early_matrix,
            **inverse_mass,
        }

    def _matrix(self, linsolver: str, options: dict[str, Any]) -> tuple[Native, Native]:
        """Early and late stage of Newton's matrix from full matrices; sets the analysis."""
        function, static = equations_of(self.method).residual_and_matrix, (self.method, self.layout)
        known = self.layout.structure.known_entries
        early = native(function, self.dynamics, *static, stage="early", **options)
        late = native(function, self.dynamics, *static, compact=known, stage="late", **options)
        late = late if known else replace(late, varying=np.arange(late.size))
        self.analysis = of_code(late, self.layout.size, self.layout.structure.n, linsolver, SMALLEST)
        return early, late

    def made(self, function: Callable[..., Any], size: int, shapes: tuple[Any, ...], *static: Any) -> Native:
        """Compile to machine code."""
        return native(function, self.dynamics, *static, shapes=shapes)

    def level_codes(self) -> dict[str, Pair]:
        """Addresses for the start of a small system that calls no Python function; else empty."""
        with _lock:
            return {name: code.pair for name, code in self._of_level.items()}

    @cached_property
    def _of_level(self) -> dict[str, Native]:
        if not self._starts_alone():
            return {}
        try:
            return level_functions(self.dynamics)
        except NotNative:
            return {}

    def _starts_alone(self) -> bool:
        """True if the start and guesses are machine code of full matrices too, without Python functions."""
        return self.alone and too_large(self.dynamics) is None


class SparseCode(MachineCode):
    """Machine code for a large system, without full matrices."""

    def __init__(self, dynamics: Dynamics, method: Method, layout: Layout, linsolver: str) -> None:
        products = step_products(dynamics, method)
        if products is None:
            raise NotNative(f"more than {MAX_FULL} unknowns, and {FULL}")
        self._rival = layout.size  #: unknowns with full matrices
        super().__init__(products, method, layout_of(products, method), linsolver)

    def _starts_alone(self) -> bool:
        return False

    def _matrix(self, linsolver: str, options: dict[str, Any]) -> tuple[Native, Native]:
        """Early and late stage of Newton's matrix, from one directional derivative per colour of its columns."""
        static, example = (self.method, self.layout), tuple(map(np.zeros, options["shapes"]))
        try:
            pattern = find_pattern(equations_of(self.method).to_differentiate, self.dynamics, *static, example=example)
        except NotImplementedError as error:
            raise NotNative(f"the pattern of its derivatives cannot be read: {error}") from error
        if pattern.computed > MAX_COMPUTED:
            raise NotNative(f"{pattern.colours} derivatives of {pattern.shape[0]} rows")
        if self._rival <= MAX_FULL and of_pattern(pattern, self.layout.size, linsolver).factor_cost > self._rival**3 / 3.0:
            raise NotNative("full matrices cost less")
        early = native(residual_and_entries, self.dynamics, *static, pattern, stage="early", **options)
        late = native(residual_and_entries, self.dynamics, *static, pattern, compact=True, stage="late", **options)
        self.analysis = of_pattern(pattern, self.layout.size, linsolver, late)
        if self.analysis.kind != "dense":
            self.newton = replace(SPARSE, matrix_cost=self.analysis.matrix_cost)
        return early, late


class PythonFunctions(Functions):
    """Functions that are all called in Python: compiled by XLA, or a NumPy system's own."""

    in_python = True

    def __init__(self, dynamics: Dynamics, method: Method, layout: Layout, linsolver: str) -> None:
        found = self._sparse(dynamics, method, layout, linsolver)
        if isinstance(found, str):
            super().__init__(dynamics, method, layout)
            self.analysis = full(layout.size, layout.structure.n, linsolver, found)
            entries = compile_function(equations_of(method).residual_and_matrix, dynamics, self.method, layout)
        else:
            products, layout, coloured = found
            super().__init__(products, method, layout)
            self.analysis = of_pattern(coloured.pattern, layout.size, linsolver)
            self.newton = replace(SPARSE, matrix_cost=self.analysis.matrix_cost)
            ends = np.s_[layout.size : layout.size + 2 * layout.structure.n]
            entries = lambda *at: np.delete(coloured.packed(*at), ends)  # noqa: E731
        static, size, n = (self.method, layout), layout.size, layout.structure.n
        shapes = (size,), self.given, None
        self._codes = {
            "residual": self.made(residual_of, size, shapes, *static),
            "matrix": (entries, self.analysis.targets.size, ((size,), (1 + size,), self.given, None)),
            "constraints": self.made(constraint_residual, size, shapes, *static),
            "end": self.made(state_after, state_size(layout), shapes, *static),
        }
        if layout.structure.mass == "variable":
            inverse = compile_function(inverse_mass_at, dynamics)
            self._codes["inverse_mass"] = (lambda t, q: inverse(t, q).ravel()), n * n, ((), (n,))

    def made(self, function: Callable[..., Any], size: int, shapes: tuple[Any, ...], *static: Any) -> Code:
        """Build a Python function."""
        route = "xla" if self.layout.size > MAX_NATIVE else None
        return compile_function(function, self.dynamics, *static, route=route), size, shapes

    @staticmethod
    def _sparse(
        dynamics: Dynamics, method: Method, layout: Layout, linsolver: str
    ) -> tuple[MatrixFree, Layout, Coloured] | str:
        """Dynamics without full matrices, its layout, and Newton's matrix by coloured entries; or the reason why not."""
        if linsolver == "dense" or (linsolver == "auto" and layout.size < SMALL):
            return f"below {SMALL} unknowns"
        products = step_products(dynamics, method)
        if not isinstance(products, MatrixFree):
            return FULL
        layout = layout_of(products, method)
        example = np.zeros(layout.size), np.zeros(1 + layout.size), np.zeros(Sizes(**memory_sizes(layout), size=0).given)
        static = replace(method, start="f0"), layout
        try:
            coloured = Coloured(equations_of(method).to_differentiate, products, *static, example=example)
        except NotImplementedError as error:  # neither the graph nor asdex knows a primitive
            return f"the pattern of its derivatives cannot be read: {error}"
        analysis = of_pattern(coloured.pattern, layout.size, linsolver)
        return analysis.reason if analysis.kind == "dense" else (products, layout, coloured)


def step_products(dynamics: Dynamics, method: Method) -> MatrixFree | ForeignProducts | None:
    """``dynamics`` without full matrices; None if it has some, or ``method`` needs M^-1 and that is full."""
    if not dynamics.structure.known_entries:
        return None
    products = foreign_products(dynamics) if route_of(dynamics) == "numpy" else matrix_free(dynamics)
    fills = products is not None and products.structure.mass == "sparse" and method.equations != "hht"
    return None if fills else products


def inverse_fills(dynamics: Dynamics, layout: Layout) -> bool:
    """True if a JAX system's mass has few entries and its inverse many, and the steps of ``layout`` need only the mass."""
    products = None if layout.extrapolated or route_of(dynamics) == "numpy" else matrix_free(dynamics)
    return products is not None and products.structure.mass == "sparse"


def functions_for(dynamics: Dynamics, method: Method, linsolver: str) -> Functions:
    """The functions of a system for ``method``, cached by dynamics: machine code where possible.

    For plain callables each engine has its own, since exceptions are noted with them.
    """
    if route_of(dynamics) == "numpy":
        return _made(dynamics, method, linsolver)
    key = by_id(dynamics), replace(method, start="f0"), linsolver
    return _known.find(key, lambda: _made(dynamics, method, linsolver))


def _made(dynamics: Dynamics, method: Method, linsolver: str) -> Functions:
    layout = layout_of(dynamics, method)
    try:
        if layout.size > MAX_FULL:
            return SparseCode(dynamics, method, layout, linsolver)
        if layout.size > FEW and inverse_fills(dynamics, layout):
            with suppress(NotNative):
                return SparseCode(dynamics, method, layout, linsolver)
        return MachineCode(foreign(dynamics) if route_of(dynamics) == "numpy" else dynamics, method, layout, linsolver)
    except NotNative:
        return PythonFunctions(dynamics, method, layout, linsolver)


def memory_sizes(layout: Layout) -> dict[str, Any]:
    """Sizes of the loops' memory that follow from structure and method."""
    s = layout.structure
    inverse_mass, applied = s.n * s.n if s.mass == "variable" else 0, s.m if layout.extrapolated else 0
    return {"n": s.n, "m": s.m, "p": s.p, "inverse_mass": inverse_mass, "applied": applied}


def layout_of(dynamics: Dynamics, method: Method) -> Layout:
    """Layout of the unknowns of ``method``'s steps."""
    return equations_of(method).layout(dynamics.structure, method)


def _pair(code: Code, callbacks: Callbacks) -> Pair:
    return code.pair if isinstance(code, Native) else (callbacks.entry(*code), 0)
