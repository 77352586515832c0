"""CPython functions outside of its stable interface; pyproject.toml bounds the Python version because of them.

The functions of :mod:`signal` convert to enums, at six microseconds around every call of machine code.
"""

from __future__ import annotations

from _signal import getsignal, signal  # type: ignore[import-not-found]

__all__ = ["getsignal", "signal"]
