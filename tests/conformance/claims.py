"""What solvers of the bench claim beyond the protocol."""

from __future__ import annotations

from typing import Any

CLAIMS: dict[str, dict[str, Any]] = {
    "hht": {"order": 2.0, "drift": 1e-10, "accuracy": 10.0, "iterations": 4.0},
    "rattle": {"order": 2.0, "drift": 1e-10},
    "generalised_alpha": {"order": 2.0, "drift": 1e-10},
    "generalised_alpha(form=index3)": {"order": 2.0},
    "hht_i3": {},
    "projected": {"drift": 1e-10},
    "ida": {},
    "cvode": {},
    "scipy(method=DOP853)": {},
    "scipy(method=Radau)": {},
    "diffrax": {},
    "collocation": {},
}


def claims_of(spec: str) -> dict[str, Any]:
    """Of the spec, or of the solver of that name whatever its options."""
    return CLAIMS.get(spec, CLAIMS.get(spec.partition("(")[0], {}))
