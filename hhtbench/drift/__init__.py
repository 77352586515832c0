"""How far a solution leaves what it should keep: both levels of the constraints, energy, invariants."""

from hhtbench.drift.measure import Drift, keeps_steps, measure_drift, own_multipliers

__all__ = ["Drift", "keeps_steps", "measure_drift", "own_multipliers"]
