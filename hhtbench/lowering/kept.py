"""What ``derive`` finds out about a system, on disk: nothing is traced again by a process that finds it there.

The name is a hash of the system's sources and values (:mod:`~hhtbench.lowering.native.sources`), of sizes and types; where
these cannot be told, files were read on the way, or a constant mass is large or not of plain float64, nothing is kept.
Errors are not kept either.
"""

from __future__ import annotations

import dataclasses
import json
from typing import Any, NamedTuple

import jax
import numpy as np

from hhtbench.lowering.diagonal import Diagonal
from hhtbench.lowering.native import disk
from hhtbench.lowering.native.sources import source_key
from hhtbench.lowering.structure import Structure
from hhtbench.protocol import System

MOST = 64  # files of one process: a study of parameters makes thousands of systems that nobody meets again
LARGEST = 10_000  # entries of a mass matrix
_written: list[str] = []


class Findings(NamedTuple):
    """Structure and constant mass of one system."""

    structure: Structure
    constant_mass: Any  #: (n, n), a Diagonal, or None
    inverse_mass: Any  #: likewise


def name_of(system: System, q: Any, v: Any, ignored: tuple[str, ...]) -> str | None:
    """The file of a system's findings for coordinates and velocities like ``q`` and ``v``; None: it cannot be named."""
    kinds = [(np.shape(x), str(np.asarray(x).dtype), bool(getattr(x, "weak_type", False))) for x in (q, v)]
    key = source_key(Structure, None, (system, ignored), ("derive", kinds))
    return None if key is None else f"{key}.structure"


def recall(name: str | None) -> Findings | None:
    """What is kept under ``name``."""
    body = None if name is None else disk.unsealed(disk.read_file(name))
    if body is None:
        return None
    line, _, rest = body.partition(b"\n")
    facts = json.loads(line)
    masses, at = [], 0
    for mass in facts["masses"]:
        values = None
        if mass is not None:
            shape = tuple(mass["shape"])
            stop = at + 8 * int(np.prod(shape))
            values, at = jax.device_put(np.frombuffer(rest[at:stop]).reshape(shape)), stop  # jnp.asarray compiles
            values = Diagonal(values) if mass["diagonal"] else values
        masses.append(values)
    return Findings(Structure(**facts["structure"]), *masses)


def keep(name: str | None, findings: Findings) -> None:
    """Put them on disk."""
    if name is None or len(_written) >= MOST:
        return
    masses, data = [], b""
    for mass in findings[1:]:
        values = mass.values if isinstance(mass, Diagonal) else mass
        if values is not None and (values.dtype != np.float64 or values.weak_type or values.size > LARGEST):
            return
        masses.append(None if values is None else {"shape": values.shape, "diagonal": isinstance(mass, Diagonal)})
        data += b"" if values is None else np.asarray(values).tobytes()
    facts = {"structure": dataclasses.asdict(findings.structure), "masses": masses}
    _written.append(name)
    disk.write_file(name, disk.sealed(json.dumps(facts).encode() + b"\n" + data))
