"""The state between two steps: all that the next step needs and nothing else, so that it can be saved."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.solution.filled import Filled


@dataclass(frozen=True, kw_only=True)
class ControlMemory:
    """What step control keeps from the last accepted step, or from the motion at the start."""

    h_next: float  #: length to try next [s], of |h|
    last: float  #: signed time from ``earlier`` to ``acceleration`` [s]
    last_but_one: float  #: signed length of the step before [s]
    q_first: Vector  #: (n,) q before the last two steps, (H59)
    q_before: Vector  #: (n,) q before the last one
    earlier: Vector  #: (n,) f + r before the last step, (H24)
    acceleration: Vector  #: (n,) f + r after it
    velocity_reaction: Vector | None = None  #: (n,) R_k, reaction of the velocity constraints
    error: float | None = None  #: size of the step's error over its tolerance, (H26)
    bound: float | None = None  #: longest step [s] since Newton's iteration has failed


@dataclass(frozen=True, kw_only=True)
class Factorised:
    """Where the stored factorisation was made, so that the same code reproduces it bit for bit."""

    at: Vector  #: the unknowns (size,), the iterate before (1 + size,), the step with its signed length [s] first, the state
    rate: float  #: worst contraction per iteration seen with it; 1 where the step needed more than one matrix
    uses: int  #: solves with it: a small matrix that serves often is inverted
    cost: float = 0.0  #: iterations of the last step begun with a stored matrix; decays while steps make new ones


@dataclass(frozen=True, kw_only=True)
class State(Filled):
    """State of an integration after a step."""

    t: float  #: [s]
    q: Vector  #: (n,)
    v: Vector  #: (n,)
    a: Vector  #: (n,) auxiliary acceleration, near f(t + alpha h), or near v' there where it holds the reactions
    f: Vector  #: (n,) M^-1 F at (t, q, v), or v' where ``a`` approximates v'
    h: float | None  #: signed length of the last step [s]; None before the first
    lam: Vector  #: (m,) multiplier estimate at t, starts the next Newton iteration or KKT solve
    mu: Vector  #: (p,) multiplier estimate of the velocity constraints
    lam_applied: Vector  #: (m,) multipliers whose reaction ``f`` and ``a`` include, (H55); (0,): none
    lam_before: Vector  #: (m,) ``lam_applied`` of the state before; of this one at the start
    vdot: Vector  #: (n,) acceleration estimate at t [m/s^2, rad/s^2]
    inverse_mass: Matrix | None  #: (n, n) at (t, q) where the mass varies
    unknowns: Vector | None  #: (size,) unknowns of the last step
    earlier: Matrix | None  #: (k, size) unknowns of up to ``HIGHEST`` = 5 steps before, newest first
    lengths: Vector | None  #: (k,) signed lengths of these steps [s]
    factorised: Factorised | None  #: the stored factorisation
    size_q: float  #: largest |q| seen
    size_v: float  #: largest |v| seen
    memory: ControlMemory | None  #: None with prescribed steps

    @cached_property
    def controlled(self) -> bool:
        """True if step-size control has begun."""
        return self.memory is not None
