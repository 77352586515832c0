"""Cross-solver validation: the pairs of solver and form at tight tolerance, against the reference."""

from hhtbench.conformance.validation.plan import validation_campaign
from hhtbench.conformance.validation.verdict import Verdict, judge

__all__ = ["Verdict", "judge", "validation_campaign"]
