"""Frozen dataclasses that our own code fills at once, and in part only when they are read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Self


class Filled:
    """A base of frozen dataclasses.  What they are given was checked before, and most of it nobody ever reads."""

    @classmethod
    def of(cls, known: dict[str, Any], read: Callable[[str], Any] | None = None) -> Self:
        """With the fields that are ``known``, in a tenth of the time of a call of the class; the rest is ``read(name)``."""
        made = cls.__new__(cls)
        made.__dict__.update(known)
        if read is not None:
            made.__dict__["_read"] = read
        return made

    def but(self, **changed: Any) -> Self:
        """The same with other fields; what nobody has read stays unread."""
        return self.of(self.__dict__ | changed)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            read = self.__dict__.get("_read")
            if read is None or name not in self.__dataclass_fields__:
                raise AttributeError(f"a {type(self).__name__} has no {name!r}")
            value = self.__dict__[name] = read(name)
            return value

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type] # a dataclass
