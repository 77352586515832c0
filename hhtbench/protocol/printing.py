"""Printing of numbers and of objects in notebooks."""

from __future__ import annotations

from html import escape


class Printed:
    """Base class whose HTML representation in a notebook is its ``str`` in a ``<pre>`` element."""

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"


def exact(x: float) -> str:
    """Return the shortest decimal text that reads back as ``x``: 0.96, 10, 1e-08."""
    return repr(float(x)).removesuffix(".0")
