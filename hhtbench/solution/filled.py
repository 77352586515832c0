"""Base of frozen dataclasses whose fields are set without ``__init__`` and may be computed when first read."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any, Self


class Filled:
    """Base of frozen dataclasses made from checked values; fields may be computed when first read."""

    __slots__ = ("_read",)  # beside the fields in ``vars``

    @classmethod
    def of(cls, known: dict[str, Any]) -> Self:
        """Make an object from ``known`` fields without ``__init__``; ``known["_read"](name)``, if any, computes others when
        read.
        """
        made = cls.__new__(cls)
        object.__setattr__(made, "_read", known.pop("_read", None))
        made.__dict__.update(known)
        return made

    def but(self, **changed: Any) -> Self:
        """Return a copy with ``changed`` fields; fields that were never read stay uncomputed."""
        return self.of({"_read": getattr(self, "_read", None), **self.__dict__, **changed})

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            if name not in self.__dataclass_fields__ or (read := getattr(self, "_read", None)) is None:
                raise AttributeError(
                    f"a {type(self).__name__} has no {name!r}; it has {', '.join(self.__dataclass_fields__)}"
                )
            value = self.__dict__[name] = read(name)
            return value

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type] # a dataclass
