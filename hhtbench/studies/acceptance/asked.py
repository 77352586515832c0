"""A solver as the rows ask it: HHT by each of its engines, and the adapters by tolerances alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import hhtbench as hb
from hhtbench.conformance.subject import Declined

ALPHAS = (0.0, -0.3)
SECONDS = 20.0  # of one solve: a row ends
RTOL = 1e-6


@dataclass(frozen=True, kw_only=True)
class Asked:
    """One column of the matrix."""

    name: str
    spec: str  #: of the solver
    engine: str = ""  #: of HHT

    @property
    def is_hht(self) -> bool:
        """Whether it is HHT, which can be asked more than a solver of the bench."""
        return bool(self.engine)

    def ways(self) -> Mapping[str, dict[str, Any]]:
        """Requests that a row is measured by unless it says otherwise: HHT with both alphas, fixed and adaptive."""
        if not self.is_hht:
            return {"": {"rtol": RTOL}}
        return {
            f"alpha={alpha:g} {name}": {"alpha": alpha, **request}
            for alpha in ALPHAS
            for name, request in (("fixed", {"step": 0.01}), ("adaptive", {"rtol": 1e-5}))
        }

    def solver(self, **options: Any) -> hb.protocol.Solver:
        """The solver of the column."""
        return hb.load_solver(self.spec, **({"engine": self.engine} | options if self.is_hht else options))

    def solve(self, problem: Any, *, alpha: float | None = None, **request: Any) -> hb.Solution:
        """One solve, bounded in time; what the solver declines raises."""
        options = {} if alpha is None else {"alpha": alpha}
        found = hb.solve(problem, self.solver(**options), **{"max_seconds": SECONDS, **request})
        if found.status is hb.Status.declined:
            raise Declined(found.message)
        return found

    def hht(self, system: Any, **options: Any) -> Any:
        """The integrator itself, for rows about its own steps."""
        if not self.is_hht:
            raise Declined("a row about HHT's own steps and options")
        return hb.HHT(system, engine=self.engine, **options)


ASKED = (
    Asked(name="hht", spec="hht", engine="compiled"),
    Asked(name="hht in Python", spec="hht", engine="python"),
    Asked(name="ida", spec="ida"),
    Asked(name="cvode", spec="cvode"),
    Asked(name="scipy", spec="scipy(method='Radau')"),
    Asked(name="diffrax", spec="diffrax"),
)
