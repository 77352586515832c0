"""Claims are functions with a name: a module's are found by it."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from hhtbench.testing.subject import Subject

Measure = Callable[..., None]


@dataclass(frozen=True)
class Claim:
    """One claim; with a scene it is made for each of these."""

    name: str  #: "status/end", or with a scene what follows its name: "levels"
    measure: Measure  #: (subject), or (subject, name of the scene)
    scenes: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """The first line of the docstring."""
        return (inspect.getdoc(self.measure) or "").partition("\n")[0]

    def named(self) -> list[tuple[str, Callable[[Subject], None]]]:
        """Name and measurement of every check that it makes."""
        if not self.scenes:
            return [(self.name, self.measure)]
        return [(f"{scene}/{self.name}", self._on(scene)) for scene in self.scenes]

    def _on(self, scene: str) -> Callable[[Subject], None]:
        return lambda subject: self.measure(subject, scene)


def claim(name: str, *scenes: str) -> Callable[[Measure], Measure]:
    """Make a measurement the claim ``name`` of its module; with ``scenes`` once for each."""

    def register(measure: Measure) -> Any:
        measure.claimed = Claim(name, measure, scenes)  # type: ignore[attr-defined]
        return measure

    return register


def claims_of(module: ModuleType) -> list[Claim]:
    """In the order in which they are written."""
    return [value.claimed for value in vars(module).values() if hasattr(value, "claimed")]
