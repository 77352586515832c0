"""Machine code of small systems for acceleration level, starts and projection, and the loops' memory for these.

Linear systems are full and solved by LAPACK; for large systems see :mod:`~solvers.kernel.kkt`.
"""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import cython_lapack

from hhtbench.lowering import CONSISTENT, Dynamics, Native, native
from hhtbench.lowering.dynamics.kkt_rows import kkt_terms
from hhtbench.lowering.dynamics.levels import level_terms
from hhtbench.lowering.dynamics.mass import SINGULAR, SYMMETRIC
from hhtbench.protocol.arguments import Vector
from solvers._finite import inverse_mass_at
from solvers.kernel import memory as mem
from solvers.kernel.memory import Memory, Sizes, allocate, integer_view

# Bounds on START_CHECKS (violation, pivot ratio, asymmetry, condition) of a good start; else Python checks further.
GOOD_START = (CONSISTENT / 2, 1e6, SYMMETRIC / 2, SINGULAR / 10)


class Places(NamedTuple):
    """Compiled projection of one system's states onto its constraints."""

    memory: Memory  #: to be copied
    mass: Vector  #: M (n*n,), or room for it where it varies; nothing by entries
    codes: Any  #: objects that own the machine code


def of_full_matrices(dynamics: Dynamics) -> Places:
    """Projection with full matrices, solved by LAPACK.

    Raises
    ------
    NotNative
        The functions cannot be machine code.
    """
    s, codes = dynamics.structure, level_functions(dynamics)
    size = s.n + s.m + s.p
    z = allocate(Sizes(n=s.n, m=s.m, p=s.p, size=0, inverse_mass=s.n**2 if s.mass == "variable" else 0, level=size))
    z.i[mem.LINEAR] = s.linear_reaction
    z.i[mem.DGETRF], z.i[mem.DGETRS] = address_of("dgetrf"), address_of("dgetrs")
    integer_view(z, mem.LEVEL_LAPACK)[:] = size, 1, ord("T"), 0
    put_codes(z, codes)
    mass = np.eye(s.n) if dynamics.constant_mass is None else np.array(dynamics.constant_mass, dtype=np.float64)
    return Places(z, mass.ravel(), codes)


def put_codes(z: Memory, codes: dict[str, Native]) -> None:
    """Write the addresses of ``codes`` into the memory."""
    for name, code in codes.items():
        at = mem.CODE + 2 * mem.FUNCTIONS.index(name)
        z.i[at : at + 2] = code.pair


def level_functions(dynamics: Dynamics) -> dict[str, Native]:
    """Machine code with full matrices for start, acceleration level and projection, by its name in the loops.

    Raises
    ------
    NotNative
        One of them cannot be compiled.
    """
    s = dynamics.structure
    place = (), (s.n,), (s.n,)
    codes = {"force": native(force_and_inverse_mass, dynamics, shapes=place)}
    if s.constrained:
        codes["start_levels"] = native(level_terms, dynamics, shapes=place)
    if s.constrained or s.mass == "variable":
        codes["kkt"] = native(kkt_terms, dynamics, shapes=(*place, (s.n + s.m + s.p,)))
    return codes


def force_over_mass(dynamics: Dynamics, t: Any, q: Any, v: Any) -> Any:
    """f = M^-1 F (n,), (H2)."""
    return dynamics.over_mass(t, q, dynamics.force(t, q, v))


def force_and_inverse_mass(dynamics: Dynamics, t: Any, q: Any, v: Any) -> Any:
    """f = M^-1 F (n,), (H2), followed by M^-1 (n*n,) where the mass varies."""
    if dynamics.structure.mass != "variable":
        return force_over_mass(dynamics, t, q, v)
    force, inverse = dynamics.force(t, q, v), inverse_mass_at(dynamics, t, q)
    return dynamics.xp.concatenate([inverse @ force, inverse.ravel()])


def address_of(name: str) -> int:
    """Address of SciPy's LAPACK routine ``name``; integers are of 32 bits, all arguments are pointers."""
    routines: Any = cython_lapack.__pyx_capi__
    capsule = routines[name]
    get_name, get_pointer = ctypes.pythonapi.PyCapsule_GetName, ctypes.pythonapi.PyCapsule_GetPointer
    get_name.restype, get_name.argtypes = ctypes.c_char_p, [ctypes.py_object]
    get_pointer.restype, get_pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    return int(get_pointer(capsule, get_name(capsule)))
