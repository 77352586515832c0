"""Machine code of one function, and the reading of it from a scalar graph."""

from __future__ import annotations

import hashlib
import json
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.lowering.scalar_compiler.emit import Emitted, emit
from hhtbench.lowering.scalar_compiler.machine import generate, host
from hhtbench.lowering.scalar_compiler.reading import Reading
from hhtbench.lowering.scalar_compiler.reasons import TooLarge

FORMAT = 2  # of the file, and of how code is generated; part of its name


@dataclass(frozen=True)
class Code:
    """What is kept of one function: on disk and in memory."""

    shape: tuple[int, ...]
    compact: bool
    operations: int
    varying: np.ndarray  #: (k,) int64
    constants: np.ndarray  #: (size,)
    binary: bytes  #: object code

    def to_bytes(self) -> bytes:
        """One line of facts, then the arrays and the object code."""
        facts = {"shape": self.shape, "compact": self.compact, "operations": self.operations}
        sizes = {"varying": self.varying.size, "constants": self.constants.size}
        return json.dumps(facts | sizes).encode() + b"\n" + self.varying.tobytes() + self.constants.tobytes() + self.binary

    @classmethod
    def from_bytes(cls, body: bytes) -> Code:
        """The inverse; the name of a file, which its format is part of, has told that it is one."""
        line, _, rest = body.partition(b"\n")
        facts = json.loads(line)
        first, second = 8 * facts["varying"], 8 * (facts["varying"] + facts["constants"])
        return cls(
            shape=tuple(facts["shape"]),
            compact=facts["compact"],
            operations=facts["operations"],
            varying=np.frombuffer(rest[:first], dtype=np.int64),
            constants=np.frombuffer(rest[first:second], dtype=np.float64),
            binary=rest[second:],
        )


@dataclass(frozen=True)
class Written:
    """A function in LLVM's language with what is known of its result."""

    emitted: Emitted
    facts: dict[str, Any]
    content: str  #: hash of all of it and of the machine: equal for equal code
    seconds: float


def write(reading: Reading, shapes: Any, *, compact: bool, limit: int) -> Written:
    """The assembly of ``reading``.

    Raises
    ------
    TooLarge
        More than ``limit`` operations.
    """
    began = time.perf_counter()
    number = reading.graph.number
    flags = np.array([node not in number for node in reading.outputs], dtype=bool)
    varying = np.flatnonzero(flags).astype(np.int64)
    constants = np.array([number.get(node, 0.0) for node in reading.outputs], dtype=np.float64)
    outputs = [reading.outputs[i] for i in varying.tolist()] if compact else reading.outputs
    emitted = emit(reading.graph, outputs, len(shapes))
    if emitted.operations > limit:
        raise TooLarge(f"{emitted.operations} scalar operations, more than {limit}")
    facts = {"shape": reading.shape, "compact": compact, "varying": varying, "constants": constants}
    content = hashlib.sha256()
    for part in (str(FORMAT), host(), emitted.text, emitted.helpers, str(reading.shape), str(compact)):
        content.update(part.encode() + b"\0")
    content.update(varying.tobytes() + constants.tobytes())
    return Written(emitted, facts, content.hexdigest(), time.perf_counter() - began)


def compiled(written: Written) -> Code:
    """Its machine code."""
    return Code(
        **written.facts,
        operations=written.emitted.operations,
        binary=generate(written.emitted.text, written.emitted.helpers, written.emitted.operations),
    )
