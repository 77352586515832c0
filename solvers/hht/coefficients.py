"""The numbers that pick one method of the extended HHT-alpha family, validated once."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

from hhtbench.arguments import real_number
from hhtbench.errors import ProblemError

REACTIONS = ("implicit", "predictor", "midpoint", "midpoint_predictor")
STARTS = ("f0", "shifted", "trapezoidal")
ALPHA_MIN = -1.0 / 3.0
ALPHA_ROUNDING = 1e-12  # -0.3333333333333 means -1/3
NEAR_HALF = 0.1  # |b - 1/2| below it: errors are five times larger than at b = 0 and grow like 1/(1 - 2b)


@dataclass(frozen=True, kw_only=True)
class Coefficients:
    """Newmark weights and the weight of the end reaction.

    The free numbers are ``alpha`` in [-1/3, 0] (0 keeps the energy of fast vibrations, -1/3 damps them most) and
    ``b != 1/2``.  Second order needs (H3).
    """

    alpha: float
    b: float

    @property
    def beta(self) -> float:
        """Weight of the end acceleration in the position, (H3)."""
        return (1.0 - self.alpha) ** 2 / 4.0

    @property
    def gamma(self) -> float:
        """Weight of the end acceleration in the velocity, (H3)."""
        return 0.5 - self.alpha

    @property
    def rho_inf(self) -> float:
        """Spectral radius at infinite frequency, (1 + alpha) / (1 - alpha), (H18)."""
        return (1.0 + self.alpha) / (1.0 - self.alpha)


@dataclass(frozen=True, kw_only=True)
class Method:
    """One member of the family, complete."""

    coefficients: Coefficients
    reaction: str = "implicit"  #: where the end reaction is taken, (H8)
    rescale_a: bool = True  #: adapt a0 when the step changes, (H11)
    start: str = "f0"  #: a0 of the first step, (H12)


def make_method(*, alpha: Any, b: Any, reaction: str, rescale_a: bool, start: str) -> Method:
    """A validated :class:`Method`.

    Raises
    ------
    ProblemError
        ``alpha`` outside [-1/3, 0], ``b`` = 1/2, an unknown reaction or start, a midpoint reaction with b != 0.
    """
    alpha, b = real_number("alpha", alpha), real_number("b", b)
    if not ALPHA_MIN - ALPHA_ROUNDING <= alpha <= 0.0:
        raise ProblemError(
            f"alpha must lie in [-1/3, 0]; got {alpha:g}. Above 0 every frequency is amplified, below -1/3 the damping at "
            "infinite frequency gets weaker again and order two buys nothing for it. It is not clamped."
        )
    if b == 0.5:
        raise ProblemError(
            "b must not be 1/2: there the position and the velocity constraint act on the same combination of the two "
            "stage reactions and the step's equations are singular (Theorem 4.1). Take b = 0."
        )
    if reaction not in REACTIONS:
        raise ProblemError(f"reaction must be one of {', '.join(REACTIONS)}; got {reaction!r}.")
    if start not in STARTS:
        raise ProblemError(f"start must be one of {', '.join(STARTS)}; got {start!r}.")
    if reaction.startswith("midpoint") and b != 0.0:
        raise ProblemError(f"the midpoint reactions are defined for b = 0; got b = {b:g}.")
    if not isinstance(rescale_a, bool):
        raise TypeError(f"rescale_a must be True or False; got {rescale_a!r}.")
    if abs(b - 0.5) < NEAR_HALF:
        warnings.warn(
            f"b = {b:g} is close to the singular value 1/2; errors grow like 1/(1 - 2b). Take b = 0.",
            UserWarning,
            stacklevel=3,
        )
    coefficients = Coefficients(alpha=max(alpha, ALPHA_MIN), b=b)
    return Method(coefficients=coefficients, reaction=reaction, rescale_a=rescale_a, start=start)
