"""The list of faults in ``planted.toml``: formulas, forms, matrices, estimator, controller, adapters, problems."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One line that is wrong."""

    name: str
    file: str
    checked: str  #: the solver whose checks should find it, "problem:SPEC", "scene:NAME" or "tests:FILES"
    first: str  #: how the names of checks begin that are tried before the others; of tests: what their names hold, as ``-k``
    right: str  #: occurs once in the file
    wrong: str
    survives: str = ""  #: why no check finds it, where that is known

    @property
    def by_tests(self) -> bool:
        """Whether tests should find it that no check of a solver can replace."""
        return self.checked.startswith("tests:")

    def planted(self, text: str) -> str:
        """``text`` of the file with the fault.

        Raises
        ------
        ValueError
            The right line is not there, or is there more than once.
        """
        count = text.count(self.right)
        if count != 1:
            raise ValueError(f"{self.name}: {self.right!r} occurs {count} times in {self.file}, not once")
        return text.replace(self.right, self.wrong)

    def plant(self, root: Path) -> str:
        """Put the fault into the tree at ``root``; returns what the file held."""
        path = root / self.file
        before = path.read_text(encoding="utf-8")
        path.write_text(self.planted(before), encoding="utf-8")
        return before


def _read() -> tuple[Fault, ...]:
    table = tomllib.loads(Path(__file__).with_name("planted.toml").read_text(encoding="utf-8"))
    return tuple(Fault(**entry) for entry in table["fault"])


FAULTS = _read()
