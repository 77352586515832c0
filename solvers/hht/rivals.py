"""Other alpha methods of the field in HHT's loops: generalised-alpha, HHT-I3 and RATTLE, with prescribed steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

from hhtbench.protocol.arguments import real_number
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import declared
from hhtbench.solution.request import Request
from solvers.hht.adapter import HHTSolver
from solvers.hht.control.controller import ControlOptions
from solvers.hht.equations.coefficients import ALPHA, Coefficients, Method, alpha_of
from solvers.hht.equations.generalised_alpha import GeneralisedAlpha
from solvers.hht.equations.hht_i3 import HHTI3
from solvers.hht.equations.rattle import Rattle
from solvers.hht.options import ENGINES, make_options
from solvers.hht.solver import HHT
from solvers.kernel.linear.analysis import KINDS

RHO_INF = 0.8  # default of generalised-alpha, a usual choice
EXTENDED = "extended"
UNCONTROLLED = "takes prescribed steps only: give step or steps; its error control is none of this bench"


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options common to these methods; names as in :class:`~solvers.hht.options.HHTOptions`."""

    linsolver: str = "auto"
    engine: str = "compiled"

    control: ClassVar[ControlOptions] = ControlOptions()
    without: ClassVar[tuple[str, ...]] = ()
    name: ClassVar[str]

    def __post_init__(self) -> None:
        for name, known in self.choices().items():
            if getattr(self, name) not in known:
                raise ProblemError(f"{name} must be one of {', '.join(known)}; got {getattr(self, name)!r}.")
        _ = self.coefficients  # numbers are checked where they are used

    def choices(self) -> dict[str, tuple[str, ...]]:
        """Allowed values of the options that are strings."""
        return {"linsolver": KINDS, "engine": ENGINES}

    @property
    def coefficients(self) -> Any:
        """Weights of the method."""
        raise NotImplementedError

    def method(self, *, controlled: bool = False) -> Method:
        """The method, as equations and weights.

        Raises
        ------
        ProblemError
            Error control is asked for.
        """
        if controlled:
            raise ProblemError(f"{self.name} {UNCONTROLLED}.")
        return Method(coefficients=self.coefficients, equations="newmark", rescale_a=False)


@dataclass(frozen=True, kw_only=True)
class GeneralisedAlphaOptions(Options):
    """Options of generalised-alpha.

    Parameters
    ----------
    rho_inf
        Spectral radius at infinite frequency, in [0, 1].
    form
        "ggl": both constraint levels, of second order on variable steps; "index3": positions only, for constant steps;
        "extended": both levels with the multipliers of the extended HHT, (H45), and velocity constraints.
    start
        Auxiliary acceleration of the first step: "shifted", as second order needs, (H41); or "f0", v' at the start.
        "corrected" (index3 only) also changes v0 as the first multipliers need, (H44); the first row has this v0.
    rescale_a
        Adapt the auxiliary acceleration when the step changes.
    """

    rho_inf: float = RHO_INF
    form: str = "ggl"
    start: str = "shifted"
    rescale_a: bool = True

    name: ClassVar[str] = "generalised_alpha"

    def choices(self) -> dict[str, tuple[str, ...]]:
        """Allowed values of the options that are strings."""
        return super().choices() | {
            "form": (EXTENDED, "ggl", "index3"),
            "start": ("shifted", "f0", *(("corrected",) if self.form == "index3" else ())),
        }

    @cached_property
    def coefficients(self) -> GeneralisedAlpha | Coefficients:
        """Weights of the method."""
        rho = real_number("rho_inf", self.rho_inf)
        if not 0.0 <= rho <= 1.0:
            raise ProblemError(f"rho_inf must lie in [0, 1]; got {rho:g}.")
        weights = GeneralisedAlpha(rho_inf=rho, form=self.form)
        return (
            Coefficients(alpha=weights.alpha, b=0.0, alpha_m=weights.alpha_m) if self.form == EXTENDED else weights
        )  # (H45)

    def method(self, *, controlled: bool = False) -> Method:
        """The method, as equations and weights."""
        equations = "hht" if self.form == EXTENDED else "newmark"
        made = super().method(controlled=controlled)
        return replace(made, equations=equations, rescale_a=self.rescale_a, start=self.start)


@dataclass(frozen=True, kw_only=True)
class HHTI3Options(Options):
    """Options of HHT-I3: damping ``alpha`` in [-1/3, 0]."""

    alpha: float = ALPHA

    name: ClassVar[str] = "hht_i3"

    @cached_property
    def coefficients(self) -> HHTI3:
        """Weights of the method."""
        return HHTI3(alpha=alpha_of(self.alpha, None))


@dataclass(frozen=True, kw_only=True)
class RattleOptions(Options):
    """Options of RATTLE, which has no parameter of its own."""

    name: ClassVar[str] = "rattle"

    @cached_property
    def coefficients(self) -> Rattle:
        """Weights of the method."""
        return Rattle()


class Rival(HHT):
    """Base class of the other alpha methods: prescribed steps only; velocity constraints in the extended form only."""

    kind: ClassVar[Any]
    name: ClassVar[str]

    @classmethod
    def declined(cls, problem: Problem, request: Request, options: Mapping[str, Any]) -> str | None:
        """Reason why a problem or request is declined (no prescribed steps, velocity constraints), or None."""
        if not request.fixed:
            return f"{cls.name} {UNCONTROLLED}"
        if declared(problem.system, "velocity_constraint") is not None and options.get("form") != EXTENDED:
            return f"{cls.name} takes position constraints only"
        return None


class GeneralisedAlphaIntegrator(Rival):
    """Generalised-alpha; options in :class:`GeneralisedAlphaOptions`."""

    kind, name = GeneralisedAlphaOptions, "generalised_alpha"


class HHTI3Integrator(Rival):
    """HHT-I3; options in :class:`HHTI3Options`."""

    kind, name = HHTI3Options, "hht_i3"


class RattleIntegrator(Rival):
    """RATTLE; options in :class:`RattleOptions`."""

    kind, name = RattleOptions, "rattle"


def _solver(integrator: type[Rival], options: dict[str, Any]) -> HHTSolver:
    make_options(integrator.kind, integrator.name, **options)
    return HHTSolver(integrator.name, options, integrator)


def generalised_alpha(**options: Any) -> HHTSolver:
    """Generalised-alpha; options as in :class:`GeneralisedAlphaOptions`."""
    return _solver(GeneralisedAlphaIntegrator, options)


def hht_i3(**options: Any) -> HHTSolver:
    """HHT-I3; options as in :class:`HHTI3Options`."""
    return _solver(HHTI3Integrator, options)


def rattle(**options: Any) -> HHTSolver:
    """RATTLE; options as in :class:`RattleOptions`."""
    return _solver(RattleIntegrator, options)
