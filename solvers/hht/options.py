"""``HHTOptions``: every option of the integrator, described and checked in one place."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

from hhtbench.lowering import REDUCTIONS
from hhtbench.protocol.arguments import real_number
from hhtbench.protocol.errors import ProblemError, did_you_mean
from solvers.hht.control.controller import ControlOptions
from solvers.hht.equations.coefficients import NEAR_HALF, REACTIONS, STARTS, Coefficients, Method, alpha_of
from solvers.kernel.linear.analysis import KINDS

LEAST_DAMPING = -0.02  # alpha above which errors of extrapolated multipliers make vibrations grow: 0.2 % by 1.05 a step
ENGINES = ("compiled", "python")


def _names(without: Any) -> tuple[str, ...]:
    """The names in ``without`` (one name or several), without duplicates and in the order of ``REDUCTIONS``."""
    given = (without,) if isinstance(without, str) else without
    if not isinstance(given, (tuple, list)) or not all(name in tuple(REDUCTIONS) for name in given):
        raise ProblemError(f"without must hold names of {', '.join(REDUCTIONS)}; got {without!r}.")
    return tuple(name for name in REDUCTIONS if name in given)


@dataclass(frozen=True, kw_only=True)
class HHTOptions:
    """The options of :class:`~solvers.hht.solver.HHT`, of its adapter and of the engines.

    Parameters
    ----------
    alpha
        Damping parameter in [-1/3, 0]; 0 keeps the energy of fast vibrations, -1/3 damps them most.  Default -0.05.
    rho_inf
        Spectral radius at infinite frequency, (1 + alpha)/(1 - alpha) in [1/2, 1]; given instead of alpha.
    b
        Weight of the end reaction in the position, not 1/2.  The default 0 is cheapest per step and the only one that is
        symplectic at alpha = 0: take it for long conservative runs.  0.2 takes 0.7 times the steps at equal error in the
        median of problems with position constraints (a pendulum a seventh; up to three times as many where forces work
        against the constraints); a step costs 1.0 to 1.9 times as much (``hhtbench verify b``).
    reaction
        Where the end reaction is evaluated: "implicit", "predictor", "midpoint" or "midpoint_predictor" (b = 0).  Avoid
        the last two for steep friction and long steps: velocities oscillate there (THEORY.md 13).
    extrapolate_reaction
        Treat the reaction of the last step's multipliers as a force, so that alpha damps vibrations carried by constraint
        forces, as of a light body on a taut rod, and steps may exceed their periods (THEORY.md 11, docs/performance.md).
        Not with alpha = 0, b near 1/2, velocity constraints, or reactions nonlinear in the multipliers.  Errors are those
        of b = 1.
    rescale_a
        Adapt the auxiliary acceleration when the step changes; without it variable steps are first-order accurate.
    start
        Auxiliary acceleration of the first step: "f0", "shifted" or "trapezoidal".  None takes "f0" for prescribed steps
        and "trapezoidal" under error control, where the first step would otherwise be short.
    first_step, min_step, max_step
        Bounds of the step under error control [s], positive also where time runs backward.
    linsolver
        "auto" picks by size and measured fill among "dense" (LAPACK), "band" (after reverse Cuthill-McKee) and "sparse"
        (SuperLU).
    without
        Names of reductions to switch off, to measure what they save: "mass" (use that it is constant), "reaction" (use
        that it is linear in the multipliers), "zeros" (skip known entries of the step's matrix).  ``linsolver="dense"``
        switches off inverse, bands and blocks.
    engine
        "compiled", or "python": the same loops over steps run as plain Python, for debugging and comparison.

    Raises
    ------
    ProblemError, TypeError
        An option is out of range; the message says what was expected.
    """

    alpha: float | None = None
    rho_inf: float | None = None
    b: float = 0.0
    reaction: str = "implicit"
    extrapolate_reaction: bool = False
    rescale_a: bool = True
    start: str | None = None
    first_step: float | None = None
    min_step: float | None = None
    max_step: float | None = None
    linsolver: str = "auto"
    without: tuple[str, ...] = ()
    engine: str = "compiled"

    def __post_init__(self) -> None:
        b, _ = self.coefficients.b, self.control  # numbers are checked where they are used
        object.__setattr__(self, "without", _names(self.without))
        choices = {"reaction": REACTIONS, "start": (None, *STARTS), "linsolver": KINDS, "engine": ENGINES}
        for name, known in choices.items():
            if getattr(self, name) not in known:
                raise ProblemError(f"{name} must be one of {', '.join(filter(None, known))}; got {getattr(self, name)!r}.")
        for name in ("extrapolate_reaction", "rescale_a"):
            if not isinstance(getattr(self, name), bool):
                raise TypeError(f"{name} must be True or False; got {getattr(self, name)!r}.")
        if self.reaction.startswith("midpoint") and b != 0.0:
            raise ProblemError(f"the midpoint reactions are defined for b = 0; got b = {b:g}.")
        if self.extrapolate_reaction and self.coefficients.alpha > LEAST_DAMPING:
            raise ProblemError(
                f"extrapolate_reaction needs an alpha of {LEAST_DAMPING:g} at most: without damping the error of what is "
                f"extrapolated makes vibrations grow (H55); got {self.coefficients.alpha:g}. Take alpha = -0.05, or -0.3."
            )
        if self.extrapolate_reaction:
            low, high = self.coefficients.unstable_b
            if low <= b <= high:
                raise ProblemError(
                    f"extrapolate_reaction needs b below {low:.6g} or above {high:.6g} with this alpha: between them the "
                    f"multipliers grow by themselves (H57); got b = {b:g}. Take b = 0, or 1."
                )
        if abs(b - 0.5) < NEAR_HALF:
            text = f"b = {b:g} is close to the singular value 1/2; errors grow like 1/(1 - 2b). Take b = 0."
            warnings.warn(text, UserWarning, stacklevel=5)  # at the call of HHT

    def method(self, *, controlled: bool = False) -> Method:
        """The member of the method family; its default ``start`` is "trapezoidal" if ``controlled``, else "f0"."""
        start = ("trapezoidal" if controlled else "f0") if self.start is None else self.start
        return Method(
            coefficients=self.coefficients,
            reaction=self.reaction,
            rescale_a=self.rescale_a,
            start=start,
            extrapolated=self.extrapolate_reaction,
        )

    @cached_property
    def coefficients(self) -> Coefficients:
        """Coefficients of the method from alpha (or rho_inf) and b."""
        b = real_number("b", self.b)
        if b == 0.5:
            raise ProblemError(
                "b must not be 1/2: there the position and the velocity constraint act on the same combination of the two "
                "stage reactions and the step's equations are singular (Theorem 4.1). Take b = 0."
            )
        return Coefficients(alpha=alpha_of(self.alpha, self.rho_inf), b=b)

    @cached_property
    def control(self) -> ControlOptions:
        """Bounds of the step [s] and constants of the step-size controller."""
        given = {name: getattr(self, name) for name in ("first_step", "min_step", "max_step")}
        bounds: dict[str, Any] = {name: real_number(name, x, unit=" [s]") for name, x in given.items() if x is not None}
        for name, value in bounds.items():
            if value <= 0:
                raise ProblemError(f"{name} must be positive [s]; got {value:g}.")
        control = ControlOptions(**bounds)
        if not control.min_step <= (control.first_step or control.min_step) <= control.max_step:
            found = ", ".join(f"{name}={value:g}" for name, value in bounds.items())
            raise ProblemError(f"min_step <= first_step <= max_step must hold; got {found}.")
        return control


DEFAULTS = HHTOptions()


def make_options(kind: Any = HHTOptions, name: str = "hht", **given: Any) -> Any:
    """Build options of class ``kind``; an unknown keyword raises ``TypeError`` listing the options of solver ``name``."""
    if not given and kind is HHTOptions:
        return DEFAULTS
    known = tuple(f.name for f in fields(kind))
    unknown = sorted(set(given) - set(known))
    if unknown:
        hint = did_you_mean(unknown[0], known)
        raise TypeError(f"{name} does not know {', '.join(unknown)}; known: {', '.join(known)}.{hint}")
    return kind(**given)
