"""Solvers on flexible, stiff and contact scenes: ``make bench-wing``."""
