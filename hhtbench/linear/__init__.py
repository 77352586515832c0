"""Equilibria and small motions: static positions, frequencies, damping and shapes."""
