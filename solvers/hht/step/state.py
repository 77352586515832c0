"""The frozen state between two steps: everything the next step needs, nothing else, so that it can be saved."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.solution.filled import Filled


@dataclass(frozen=True, kw_only=True)
class ControlMemory:
    """What step control keeps of the last accepted step, or of the motion at the start."""

    h_next: float  #: length to try next [s], of |h|
    last: float  #: signed time between the two accelerations [s]
    last_but_one: float  #: the same of the step before, or of the start [s]
    q_first: Vector  #: (n,) q before the last two steps, (H59)
    q_before: Vector  #: (n,) q before the last one
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
class State(Filled):
    """Where an integration stands after a step."""

    t: float  #: [s]
    q: Vector  #: (n,)
    v: Vector  #: (n,)
    a: Vector  #: (n,) auxiliary acceleration, near f(t + alpha h), or near v' there where it holds the reactions
    f: Vector  #: (n,) M^-1 F at (t, q, v), or v' where ``a`` is near that
    h: float | None  #: signed length of the last step [s]; None before the first
    lam: Vector  #: (m,) multiplier estimate at t, starts the next Newton iteration or KKT solve
    mu: Vector  #: (p,) the same for the velocity constraints
    lam_applied: Vector  #: (m,) multipliers whose reaction is in ``f`` and ``a``, (H55); (0,): none is
    lam_before: Vector  #: (m,) those in the ``f`` of the state before; ``lam_applied`` itself where nothing was before
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
