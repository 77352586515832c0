"""One system's machine code and arrays for the compiled loops, and the way from a State to those arrays and back."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from hhtbench.lowering import Native, native
from hhtbench.lowering.caching import ById, Cache
from hhtbench.lowering.dynamics.kkt import kkt_terms
from solvers._finite import inverse_mass_at
from solvers.hht.coefficients import Method
from solvers.hht.corrections import SMALL as SMALLEST
from solvers.hht.corrections import (
    fresh_correction,
    kept_correction_and_end,
    residual_and_end,
    residual_and_matrix,
    state_size,
)
from solvers.hht.laws import HIGHEST
from solvers.hht.layout import Layout
from solvers.hht.local_error import SCALARS, inputs, levels, raw_errors
from solvers.hht.native.entries import Entries
from solvers.hht.native.matrix import INVERTED
from solvers.hht.native.tables import (
    ACCELERATION,
    BASE,
    BEFORE,
    FUNCTIONS,
    HEADERS,
    INVERSE,
    LAM,
    MEMORY,
    MU,
    NEWTON_CONSTANTS,
    NUMBER,
    O_R1,
    OWN,
    ROLLING,
    SMALL,
    VARIABLE,
    VDOT,
    X_EARLIER,
    X_LAST,
    A,
    F,
    Memory,
    N,
    Q,
    V,
    floats,
    memory,
)
from solvers.hht.state import Memory as StepMemory
from solvers.hht.state import State
from solvers.hht.weights import GIVEN, HEAD

_kernels = Cache(16)  # ordering a matrix takes a millisecond
_lock = threading.RLock()


def kernel_for(dynamics: Any, method: Method, layout: Layout) -> Kernel:
    """The :class:`Kernel`, remembered for the same dynamics."""
    return _kernels.find((ById(dynamics), replace(method, start="f0")), lambda: Kernel(dynamics, method, layout))


class Kernel:
    """Code and arrays of one method for one system; its functions are compiled when it is made.

    Raises
    ------
    NotNative
        A function of the system cannot be compiled to machine code.
    """

    def __init__(self, dynamics: Any, method: Method, layout: Layout) -> None:
        s = layout.structure
        variable = s.mass == "variable"
        self._inverse = native(inverse_mass_at, dynamics, shapes=((), (s.n,))) if variable else None
        if self._inverse is not None:
            known = np.flatnonzero(self._inverse.constants).tolist()
            places = tuple(sorted({*self._inverse.varying.tolist(), *known}))
            layout = replace(layout, inverse_places=places)
        self.layout, self.dynamics = layout, dynamics
        self.method = replace(method, start="f0")  # the first step's a0 is the loop's affair
        x, given = (layout.size,), (len(GIVEN) + len(HEAD) + state_size(layout) + (s.n * s.n if variable else 0),)
        options: Any = {"shapes": (x, given)}
        static = self.method, layout
        self._matrix_early = native(residual_and_matrix, dynamics, *static, stage="early", **options)
        self._matrix = native(residual_and_matrix, dynamics, *static, compact=True, stage="late", **options)
        self.analysis = Entries(self._matrix, layout)
        self.small = layout.size <= SMALLEST
        function: Any = residual_and_end
        head, more = layout.size, tuple[Any, ...]()
        if self.small:  # corrections in the place of residual and matrix
            entries = self.analysis.flat[self.analysis.own :] - layout.size**2
            more = (tuple(entries.tolist()),)
            self._matrix_early, self._matrix = (
                native(fresh_correction, dynamics, *static, *more, stage=stage, **options) for stage in ("early", "late")
            )
            function, head = kept_correction_and_end, layout.size + 2
            options = {"shapes": (x, (layout.size**2,), (entries.size,), given)}
        ends = head + state_size(layout) + (2 * s.n if s.m else 0)
        self._residual_early = native(function, dynamics, *static, *more, stage="early", **options)
        self._residual, self._end = (
            native(function, dynamics, *static, *more, stage="late", rows=rows, **options)
            for rows in ((0, head), (head, ends))
        )
        self._raw: Native | None = None
        self._levels: Native | None = None
        self._blank: Memory | None = None  #: without events, to be copied
        self._controlled = False  #: whether those two are there

    def code(self, *, controlled: bool) -> list[int]:
        """Addresses of functions and parameters; those of the error estimate only where step control needs them."""
        if controlled and not self._controlled:
            with _lock:  # kernels are shared between solvers, and these between threads
                self._prepare_control()
        late = self._residual, self._matrix, self._end, self._inverse, self._raw, self._levels
        parts = *late, self._residual_early, self._matrix_early
        pairs = [(0, 0) if part is None else (part.address, part.parameters.ctypes.data) for part in parts]
        return [number for pair in pairs for number in pair]

    def _prepare_control(self) -> None:
        s, count = self.layout.structure, len(SCALARS) + sum(inputs(self.layout).values())
        self._raw = native(raw_errors, self.dynamics, self.method, self.layout, shapes=((count,),))
        if s.constrained:
            self._levels = native(levels, self.dynamics, shapes=((), (s.n,), (s.n,)))
        self._controlled = True

    def memory(self, events: Mapping[str, Any], count: int) -> Memory:
        """Room for the loops of one engine with ``count`` event functions; no state is in it yet."""
        if count:
            return self._memory(events, count)
        if self._blank is None:
            self._blank = self._memory(events, 0)
        z = Memory(self._blank.w.copy(), self._blank.i.copy())
        z.i[BASE] = z.w.ctypes.data
        return z

    def _memory(self, events: Mapping[str, Any], count: int) -> Memory:
        s, size, analysis = self.layout.structure, self.layout.size, self.analysis
        n, m, p = s.n, s.m, s.p
        raw = len(SCALARS) + sum(inputs(self.layout).values())
        full = n * n if s.mass == "variable" else 0
        lengths = {
            "step": len(GIVEN),
            "number": len(HEAD),
            "q": n,
            "v": n,
            "a": n,
            "f": n,
            "lam": m,
            "mu": p,
            "vdot": n,
            "inverse": full,
            "x_last": size,
            "x_earlier": HIGHEST * size,
            "memory": 4,
            "before": n,
            "acceleration": n,
            "rolling": n,
            "early": self._residual_early.size,
            "early_matrix": self._matrix_early.size,
            "x": size,
            "residual": size,
            "computed": analysis.slots.size,
            "values": size + analysis.flat.size,
            "right": size,
            "work": size,
            "increment": size + 2,
            "rights": 2 * size,
            "works": 2 * size,
            "answers": 2 * size,
            "changes": 4 * n,
            "base_x": size,
            "full": size + 2,
            "undisturbed": 4 * n,
            "end": self._end.size,
            "end_inverse": n * n,
            "raw_given": raw,
            "raw": 3 * n,
            "place": 1 + 2 * n,
            "levels": 2 * m + p,
            "error": 2 * n,
            "weights": 2 * n,
            "rtol": 2 * n,
            "atol": 2 * n,
            "storage": 0 if self.small else 2 * analysis.order.storage,
            "factor_h": 2,
            "rate": 2,
            "uses": 2,
            "built": 2,
            "couplings": 0 if self.small else 2 * analysis.band.outside.size,
            "fresh": self._matrix.size if self.small else 0,
            "maps": 2 * (analysis.flat.size - analysis.own),
            "inverse_matrix": 2 * size * size if size <= INVERTED else 0,
            "constants": 3 + len(NEWTON_CONSTANTS),
            "event": 1,
            "event_values": count,
            "event_ends": count,
        }
        contents = {name: np.zeros(length) for name, length in lengths.items()} | {"values": analysis.values}
        header = np.zeros(len(HEADERS) + 2 * len(FUNCTIONS), dtype=np.int64)
        z = memory(contents, {"header": header, "pivots": np.zeros(2 * size)} | analysis.places | dict(events))
        offsets, at = {}, 0
        for name, length in self.layout.unknowns.items():
            offsets[name], at = at, at + length
        z.i[N : N + 4] = n, m, p, size
        z.i[O_R1 : O_R1 + 5] = [offsets.get(name, -1) for name in ("R1", "lam0", "lam1", "Rk", "mu")]
        z.i[VARIABLE], z.i[OWN], z.i[SMALL] = full > 0, analysis.own, self.small
        return z

    def kkt(self) -> Native:
        """Residual and matrix of the acceleration level, :func:`hhtbench.lowering.dynamics.kkt.kkt_terms`."""
        s = self.layout.structure
        return native(kkt_terms, self.dynamics, shapes=((), (s.n,), (s.n,), (s.n + s.m + s.p,)))

    def load(self, z: Memory, state: State) -> None:
        """Put ``state`` into the loops' memory."""
        x, earlier, memory = state.unknowns, state.earlier, state.memory
        kept = self.analysis.load(state.factor, z)
        known = 0 if x is None else 1 + (0 if earlier is None else len(earlier))
        floats(z, NUMBER)[:] = state.t, state.h or 0.0, state.size_q, state.size_v, known, -1.0 if kept is None else kept
        vectors: dict[int, Any] = {
            Q: state.q,
            V: state.v,
            A: state.a,
            F: state.f,
            LAM: state.lam,
            MU: state.mu,
            VDOT: state.vdot,
        }
        vectors |= {X_LAST: x, X_EARLIER: earlier}
        if self.layout.structure.mass == "variable" and state.inverse_mass is not None:
            vectors[INVERSE] = state.inverse_mass.ravel()
        if memory is not None:
            error, rolling = -1.0 if memory.error is None else memory.error, memory.velocity_reaction
            floats(z, MEMORY)[:] = memory.h_next, memory.last, error, rolling is not None
            vectors |= {BEFORE: memory.earlier, ACCELERATION: memory.acceleration, ROLLING: rolling}
        for name, values in vectors.items():
            if values is not None:
                floats(z, name)[: values.size] = values.ravel()

    def store(self, z: Memory, before: State) -> State:
        """The state that the loops left in their memory; ``before`` is the one they began with."""
        t, h, size_q, size_v, known, kept = floats(z, NUMBER).tolist()
        memory, own = None, lambda name: floats(z, name).copy()
        if before.memory is not None:
            h_next, last, error, rolling = floats(z, MEMORY).tolist()
            memory = StepMemory(
                h_next=h_next,
                last=last,
                earlier=own(BEFORE),
                acceleration=own(ACCELERATION),
                velocity_reaction=own(ROLLING) if rolling else None,
                error=None if error < 0.0 else error,
            )
        n = self.layout.structure.n
        return State(
            t=t,
            q=own(Q),
            v=own(V),
            a=own(A),
            f=own(F),
            h=h,
            lam=own(LAM),
            mu=own(MU),
            vdot=own(VDOT),
            inverse_mass=own(INVERSE).reshape(n, n) if before.inverse_mass is not None else None,
            unknowns=own(X_LAST),
            earlier=own(X_EARLIER).reshape(HIGHEST, -1)[: int(known) - 1] if known > 1.0 else None,
            factor=self.analysis.store(z, int(kept)),
            size_q=size_q,
            size_v=size_v,
            memory=memory,
        )
