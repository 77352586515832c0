"""Drawings of motions: states over time, scenes of points and lines, figures, the table of all problems."""
