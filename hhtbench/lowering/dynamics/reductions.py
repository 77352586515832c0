"""Names of reductions (properties read from a system that save work), and the structure without them.

Derivatives by arguments that a function does not use are no reductions: the compiler always sees that they are zero.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

from hhtbench.lowering.dynamics.dynamics import Structure

REDUCTIONS: Mapping[str, Mapping[str, Any]] = {
    "mass": {"mass": "variable"},  # one inverse, no derivative of M x; reactions of M^-1 that is known are eliminated
    "reaction": {"linear_reaction": False},  # one linear solve for the multipliers
    "zeros": {"known_entries": False},  # of a step's matrix only what varies is computed, only what is not zero is kept
}


def generalised(structure: Structure, without: Collection[str]) -> Structure:
    """``structure`` with the reductions named in ``without`` switched off."""
    changes = {name: value for reduction in without for name, value in REDUCTIONS[reduction].items()}
    return replace(structure, **changes) if changes else structure
