"""Machine code of any system for acceleration level, constraint levels and projection, and the loops' memory for these.

Linear systems are full, or for large systems given by the entries of the KKT matrix, in bands where these pay.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from hhtbench.lowering import Dynamics, Native, NotNative, native
from hhtbench.lowering.caching import Cache, by_id
from hhtbench.lowering.compile.coloured import find_pattern
from hhtbench.lowering.compile.routes import too_large
from hhtbench.lowering.dynamics.kkt_rows import kkt_residual, kkt_terms
from hhtbench.lowering.dynamics.matrix_free import Conjugate, kkt_entries
from hhtbench.lowering.dynamics.products import paying_products
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.system import declared
from solvers.kernel import memory as mem
from solvers.kernel.full import Places, force_and_inverse_mass, of_full_matrices, put_codes
from solvers.kernel.linear.analysis import Analysis, chosen
from solvers.kernel.memory import Memory, Sizes, allocate

MAX_FULL = 300  # unknowns up to which code of full matrices is compiled: three seconds, and fourteen at 480
_known = Cache(16)  # ordering a matrix takes a millisecond and more


class Entries(NamedTuple):
    """Machine code for the entries of the KKT matrix, and the analysis for its factorisation."""

    kkt: Native  #: [residual; entries] of (H16)
    analysis: Analysis

    def memory(self, dynamics: Dynamics) -> Memory:
        """Memory of the loops for acceleration level and projection."""
        s = dynamics.structure
        z = self.analysis.memory(n=s.n, m=s.m, p=s.p, inverse_mass=0, computed=self.kkt.size, by_entries=True)
        z.i[mem.C_MATRIX : mem.C_MATRIX + 2], z.i[mem.LINEAR] = self.kkt.pair, s.linear_reaction
        return z


def places_of(dynamics: Dynamics) -> Places:
    """Compiled projection, by full matrices or by entries, whichever is faster at its size.

    Raises
    ------
    NotNative
        The functions cannot be machine code.
    """
    if not dynamics.matrices or too_large(dynamics) is not None:
        return by_entries(dynamics)
    if dynamics.structure.constrained and paying_products(dynamics) is not None:
        with suppress(NotNative):
            return by_entries(dynamics)
    return of_full_matrices(dynamics)


def by_entries(dynamics: Dynamics) -> Places:
    """Compiled projection by the entries of the KKT matrix, or for a system without constraints.

    Raises
    ------
    NotNative
        The functions cannot be machine code, or declared reactions have another direction than C^T.
    """
    s, products = dynamics.structure, paying_products(dynamics) if dynamics.matrices else dynamics
    source, place = dynamics if products is None else products, ((), (s.n,), (s.n,))
    if not s.constrained:
        codes = {"force": native(force_and_inverse_mass, source, shapes=place)}
        z = allocate(Sizes(n=s.n, m=0, p=0, size=0, inverse_mass=s.n**2 if s.mass == "variable" else 0))
        put_codes(z, codes)
        return Places(z, np.zeros(0), codes)
    if reacts_across(dynamics) and not isinstance(dynamics, Conjugate):
        raise NotNative("a declared reaction")
    entries = kkt_of(dynamics)
    if entries is None:
        raise NotNative("the entries of its KKT matrix are none of machine code")
    z, codes = entries.memory(dynamics), {"levels": native(levels, source, shapes=place)}
    put_codes(z, codes)
    return Places(z, np.zeros(0), (entries, codes))


def reacts_across(dynamics: Dynamics) -> bool:
    """True if reactions are declared, so that they need not have the direction of C^T."""
    return any(declared(dynamics.system, name) is not None for name in ("reaction", "velocity_reaction"))


def kkt_of(dynamics: Dynamics) -> Entries | None:
    """Cached machine code for the entries of the KKT matrix.

    None if it is not machine code, or if SuperLU would factorise the matrix.
    """
    found: list[Entries] = _known.find(by_id(dynamics), lambda: _kkt_of(paying_products(dynamics) or dynamics))
    return found[0] if found else None


def _kkt_of(dynamics: Dynamics) -> list[Entries]:
    try:
        found = kkt_code(dynamics)
    except (NotNative, NotImplementedError):  # the second: a pattern that cannot be read
        return []
    return [] if found.analysis.kind == "sparse" else [found]


def kkt_code(dynamics: Dynamics) -> Entries:
    """Machine code of residual and matrix of (H16), and the linear algebra for its nonzero entries.

    ``targets`` of the analysis: positions of [residual; entries] in the code's result.

    Raises
    ------
    NotNative
        It cannot be compiled, or that would take long.
    """
    s = dynamics.structure
    size, vector = s.n + s.m + s.p, (s.n,)
    if size > MAX_FULL and dynamics.matrices:
        raise NotNative(f"full matrices of {size} unknowns")
    shapes = (), vector, vector, (size,)
    if not dynamics.matrices:
        pattern = find_pattern(kkt_residual, dynamics, example=(np.zeros(size), 0.0, np.zeros(s.n), np.zeros(s.n)))
        code = native(kkt_entries, dynamics, pattern, shapes=shapes)
        places = np.stack([pattern.rows, pattern.columns, np.arange(size, size + pattern.rows.size)])
    else:
        code = native(kkt_terms, dynamics, shapes=shapes)
        flat = np.union1d(code.varying, np.flatnonzero(code.constants))
        flat = flat[flat >= size]
        places = np.stack([flat // size - 1, flat % size, flat])
    if s.m and s.p:  # a place on the diagonal for rows of k: at the position level they are those of the identity
        held = np.arange(s.n + s.m, size)
        places = np.concatenate([places, np.stack([held, held, 0 * held])], axis=1)
    rows, columns, targets = places[:, np.lexsort(places[1::-1])]
    targets = np.concatenate([np.arange(size), targets])
    found = Analysis(size, rows, columns, 0, targets, np.zeros(targets.size))
    return Entries(code, chosen(found, "auto", measured=not dynamics.matrices))


def levels(dynamics: Dynamics, t: Any, q: Any, v: Any) -> Any:
    """Constraint levels g, g_t + g_q v, k, (2 m + p,)."""
    rows = [dynamics.constraint(t, q), dynamics.constraint_velocity(t, q, v)] if dynamics.structure.m else []
    rows += [dynamics.velocity_constraint(t, q, v)] if dynamics.structure.p else []
    return dynamics.xp.concatenate(rows)


def acceleration_level(run: Any, t: float, q: Vector, v: Vector, lam: Vector, mu: Vector) -> Vector:
    """[1 if determined, else 0; lam (m,), mu (p,), v' (n,)], (H16), solved in Python."""
    found = run.acceleration.solve(t, q, v, lam, mu)
    return np.concatenate([[found.converged], found.lam, found.mu, found.vdot])
