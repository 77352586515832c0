"""How numbers and objects are printed."""

from __future__ import annotations

from html import escape


class Printed:
    """Base of objects that a notebook shows as their ``str``."""

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"


def exact(x: float) -> str:
    """The shortest decimal text that reads back as ``x``: 0.96, 10, 1e-08."""
    return repr(float(x)).removesuffix(".0")
