"""What CPython has outside of its stable interface, imported here and nowhere else; pyproject.toml bounds Python for it.

:mod:`signal` makes enums of what these return and take, at six microseconds around every call of machine code.
"""

from __future__ import annotations

from _signal import getsignal, signal  # type: ignore[import-not-found]

__all__ = ["getsignal", "signal"]
