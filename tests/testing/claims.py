"""What solvers of the bench claim beyond the protocol, and what is known of them."""

from __future__ import annotations

from typing import Any

COLLOCATED = ("position", "declared", "mass", "velocity", "mixed")
EXPLICIT = {"stiff/implicit": "its Jacobians are those of the constraints; in the forces it is explicit"}
SEGMENTS = {"budget/evaluations": "its compiled loop is looked at after up to SEGMENT attempts, and not in between"}
SEEKS = {
    **{f"{scene}/newton": "it finds the longest step by trying: a start too long fails" for scene in COLLOCATED},
    "callables/differences": "its iteration goes to roundoff, which Jacobians by differences do not reach",
}
CLAIMS: dict[str, dict[str, Any]] = {
    "hht": {"order": 2.0, "drift": 1e-10, "accuracy": 10.0, "iterations": 4.0},
    "rattle": {"order": 2.0, "drift": 1e-10, "expected_failed": EXPLICIT},
    "generalised_alpha": {"order": 2.0, "drift": 1e-10},
    "generalised_alpha(form=index3)": {"order": 2.0},
    "hht_i3": {},
    "projected": {"drift": 1e-10},
    "ida": {},
    "cvode": {},
    "scipy(method=DOP853)": {},
    "scipy(method=Radau)": {},
    "diffrax": {"expected_failed": SEGMENTS},
    "collocation": {"expected_failed": SEEKS},
}


def claims_of(spec: str) -> dict[str, Any]:
    """Of the spec, or of the solver of that name whatever its options."""
    return CLAIMS.get(spec, CLAIMS.get(spec.partition("(")[0], {}))
