"""The frozen state between two steps: everything the next step needs, nothing else, so that it can be saved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any

from hhtbench.arguments import Matrix, Vector


@dataclass(frozen=True, kw_only=True)
class ControlMemory:
    """What step control keeps of the last accepted step, or of a look at the motion before the first."""

    h_next: float  #: length to try next [s], of |h|
    last: float  #: signed time between the two accelerations [s]
    earlier: Vector  #: (n,) f + r before the last step, (H24)
    acceleration: Vector  #: (n,) f + r after it
    velocity_reaction: Vector | None = None  #: (n,) R_k
    error: float | None = None  #: size of the step's error over what was allowed, (H26)


@dataclass(frozen=True, kw_only=True)
class Factorised:
    """Where the kept factorisation of Newton's matrix was made: the same code makes the same bits of it again."""

    at: Vector  #: the unknowns (size,), then the step, its signed length [s] first, and the state before it
    rate: float  #: worst contraction per iteration seen with it
    uses: int  #: solves with it: a small matrix that serves often is inverted
    cost: float = 0.0  #: iterations of the last step that began with a kept one, fading where steps make their own


@dataclass(frozen=True, kw_only=True)
class State:
    """Where an integration stands after a step."""

    t: float  #: [s]
    q: Vector  #: (n,)
    v: Vector  #: (n,)
    a: Vector  #: (n,) auxiliary acceleration, near f(t + alpha h), or near v' there where it holds the reactions
    f: Vector  #: (n,) M^-1 F at (t, q, v), or v' where ``a`` is near that
    h: float | None  #: signed length of the last step [s]; None before the first
    lam: Vector  #: (m,) multiplier estimate at t, starts the next Newton iteration or KKT solve
    mu: Vector  #: (p,) the same for the velocity constraints
    vdot: Vector  #: (n,) acceleration estimate at t [m/s^2, rad/s^2]
    inverse_mass: Matrix | None  #: (n, n) at (t, q) where the mass varies
    unknowns: Vector | None  #: (size,) of the last step
    earlier: Matrix | None  #: (k, size) of up to five before it (``HIGHEST``) of the same length, newest first
    factorised: Factorised | None  #: the kept factorisation
    size_q: float  #: largest |q| seen
    size_v: float  #: largest |v| seen
    memory: ControlMemory | None  #: None with prescribed steps

    @cached_property
    def controlled(self) -> bool:
        """Whether step control has begun."""
        return self.memory is not None

    @classmethod
    def read_later(cls, read: Callable[[str], Any], **known: Any) -> State:
        """The state that is ``known`` in part; the rest is ``read(name)`` when asked for: of most states it never is."""
        state = cls.__new__(cls)
        state.__dict__.update(known, _read=read)
        return state

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            found = self.__dict__
            if "_read" not in found or name not in self.__dataclass_fields__:
                raise AttributeError(f"a State has no {name!r}")
            value = found[name] = found["_read"](name)
            return value

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}
