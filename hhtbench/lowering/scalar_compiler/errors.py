"""``NotNative``: why a function cannot be had as machine code of this route."""

from __future__ import annotations


class NotNative(Exception):
    """The native route does not know how, or it would not pay; XLA does it instead."""

    def __init__(self, reason: str) -> None:
        self.reason = reason  #: in words, with the user's source line where it is known
        super().__init__(reason)


class TooLarge(NotNative):
    """More scalar operations than pay."""
