"""Bodies, joints and forces from which a System is put together: ``space``, ``plane``, ``forces``, ``lines`` for drawings.

Functions on arrays, no classes: a System calls them in its own ``mass_matrix``, ``force`` and ``constraint``, in a few lines
each, for any number of bodies or joints at once.
"""

from hhtbench.mechanics import forces, lines, plane, space

__all__ = ["forces", "lines", "plane", "space"]
