"""Coefficients that select one method of the extended HHT-alpha family, with their checks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from hhtbench.protocol.arguments import real_number
from hhtbench.protocol.errors import ProblemError

REACTIONS = ("implicit", "predictor", "midpoint", "midpoint_predictor")
STARTS = ("f0", "shifted", "trapezoidal")
ALPHA = -0.05  # the default: rho_inf = 0.905
ALPHA_MIN = -1.0 / 3.0
RHO_INF_MIN = 0.5  # rho_inf at ALPHA_MIN
ROUNDING = 1e-12  # tolerance of the bounds: -0.3333333333333 means -1/3
NEAR_HALF = 0.1  # |b - 1/2| below it: errors are five times larger than at b = 0 and grow like 1/(1 - 2b)


class NewmarkWeights:
    """Newmark weights for a damping ``alpha``, shared by the extended HHT and the other alpha methods."""

    alpha: float

    @property
    def beta(self) -> float:
        """Weight of the end acceleration in the position, (H3), (H39)."""
        return (1.0 - self.alpha) ** 2 / 4.0

    @property
    def gamma(self) -> float:
        """Weight of the end acceleration in the velocity, (H3), (H39)."""
        return 0.5 - self.alpha


@dataclass(frozen=True, kw_only=True)
class Coefficients(NewmarkWeights):
    """Newmark weights and the weight of the end reaction.

    Free parameters are ``alpha`` in [-1/3, 0] (0 keeps the energy of fast vibrations, -1/3 damps them most) and
    ``b != 1/2``.  Second order needs (H3).  With ``alpha_m`` it is generalised-alpha, whose alpha_m - alpha_f takes the
    place of ``alpha``, (H45).
    """

    alpha: float
    b: float
    alpha_m: float = 0.0  #: weight of the earlier accelerations in the balance, (H45)

    total: ClassVar[bool] = False  #: True if a includes the reactions, so that it approximates v' and not f
    both_levels: ClassVar[bool] = True  #: True if steps end on both levels of the constraints

    @property
    def rho_inf(self) -> float:
        """Spectral radius at infinite frequency, (1 + alpha) / (1 - alpha), (H18)."""
        return (1.0 + self.alpha) / (1.0 - self.alpha)

    @property
    def unstable_b(self) -> tuple[float, float]:
        """Interval of b in which extrapolated multipliers are unstable, (H57)."""
        return (1.0 - self.alpha**2) / 2.0, 0.5 + self.alpha**2 / 4.0


@dataclass(frozen=True, kw_only=True)
class Method:
    """One complete method: a member of the family or another alpha method."""

    coefficients: Any  #: :class:`Coefficients`, or those of other equations with alpha, beta, gamma, b and total
    equations: str = "hht"  #: one of :data:`~solvers.hht.equations.methods.EQUATIONS`
    reaction: str = "implicit"  #: where the end reaction is evaluated, (H8)
    rescale_a: bool = True  #: adapt a0 when the step changes, (H11)
    start: str = "f0"  #: a0 of the first step, (H12)
    extrapolated: bool = False  #: True if f includes the reaction of extrapolated multipliers, (H55)

    @property
    def total(self) -> bool:
        """True if f and a include reactions, so that at a start they equal v'."""
        return bool(self.coefficients.total or self.extrapolated)


def alpha_of(alpha: Any, rho_inf: Any) -> float:
    """The damping parameter alpha from ``alpha`` or ``rho_inf``, (H18); the default if neither is given.

    Raises
    ------
    ProblemError
        Both are given, ``alpha`` is outside [-1/3, 0] or ``rho_inf`` outside [1/2, 1].
    """
    if alpha is not None and rho_inf is not None:
        raise ProblemError(
            f"alpha and rho_inf are two names of one damping, rho_inf = (1 + alpha)/(1 - alpha); got alpha = {alpha!r} and "
            f"rho_inf = {rho_inf!r}. Give one of them."
        )
    if rho_inf is not None:
        rho = real_number("rho_inf", rho_inf)
        if not RHO_INF_MIN - ROUNDING <= rho <= 1.0:
            raise ProblemError(
                f"rho_inf must lie in [1/2, 1]; got {rho:g}. It is the factor by which a step multiplies vibrations of "
                "infinite frequency: 1 keeps them (alpha = 0), 1/2 is the least this method reaches (alpha = -1/3)."
            )
        return max((rho - 1.0) / (rho + 1.0), ALPHA_MIN)  # (H18)
    number = ALPHA if alpha is None else real_number("alpha", alpha)
    if not ALPHA_MIN - ROUNDING <= number <= 0.0:
        raise ProblemError(
            f"alpha must lie in [-1/3, 0]; got {number:g}. Above 0 every frequency is amplified, below -1/3 the damping at "
            "infinite frequency gets weaker again and order two buys nothing for it. It is not clamped."
        )
    return max(number, ALPHA_MIN)
