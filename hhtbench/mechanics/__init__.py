"""Mechanisms by name, :class:`Mechanism`, and elements of Systems:
``space``, ``plane``, ``forces``, ``beams``, ``bushings``, ``cables``, ``contact``, ``lines``, ``tyres``.

The elements are functions on arrays: a System calls them in its own ``mass_matrix``, ``force`` and ``constraint``, for any
number of bodies or joints at once.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hhtbench.mechanics import beams, bushings, cables, contact, forces, lines, plane, space, tyres
    from hhtbench.mechanics.multibody.mechanism import Mechanism

__all__ = ["Mechanism", "beams", "bushings", "cables", "contact", "forces", "lines", "plane", "space", "tyres"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name == "Mechanism":
        return import_module(f"{__name__}.multibody.mechanism").Mechanism
    return import_module(f"{__name__}.{name}")
