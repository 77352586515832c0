"""Machine speed side by side: hand-written C, Exudyn, the reference solvers.  ``make bench-engine``."""
