"""Named checks: what is claimed, how it is measured, and what is known to fail."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from enum import Enum
from typing import Any
from unittest import SkipTest


class Kind(Enum):
    """How a check ended."""

    passed = "passed"
    failed = "failed"
    declined = "declined"  # the solver has said that it cannot take what is asked
    expected = "fails as expected"
    unexpected = "passes unexpectedly"

    @property
    def good(self) -> bool:
        """Whether nothing is to be done."""
        return self not in (Kind.failed, Kind.unexpected)


@dataclass(frozen=True)
class Verdict:
    """One check that was run."""

    name: str
    kind: Kind
    message: str  #: what was measured where it fails, why it was declined


@dataclass(frozen=True)
class Check:
    """One claim about one solver or problem; call it, and it raises ``AssertionError`` where the claim does not hold."""

    name: str  #: "mixed/levels"
    claim: str  #: a sentence
    measure: Callable[[], None]  #: raises AssertionError or SkipTest
    expected_failed: str = ""  #: the reason why it is known to fail; then passing is the failure

    def __str__(self) -> str:
        return self.name

    def __call__(self) -> None:
        """Raise AssertionError (fails, or passes unexpectedly) or SkipTest (declined, or fails as expected)."""
        verdict = self.run()
        if not verdict.kind.good:
            raise AssertionError(f"{self.name}: {verdict.message}")
        if verdict.kind is not Kind.passed:
            raise SkipTest(f"{verdict.kind.value}: {verdict.message}")

    def run(self) -> Verdict:
        """The same as a verdict; nothing is raised but what interrupts."""
        kind, message = Kind.passed, ""
        try:
            self.measure()
        except SkipTest as declined:
            return Verdict(self.name, Kind.declined, str(declined))
        except Exception as error:  # noqa: BLE001 - whatever the solver raises, the claim does not hold
            own = isinstance(error, AssertionError)
            kind, message = Kind.failed, str(error) if own else f"{type(error).__name__}: {error}"
        if not self.expected_failed:
            return Verdict(self.name, kind, message)
        if kind is Kind.failed:
            return Verdict(self.name, Kind.expected, f"{self.expected_failed} ({message})")
        text = f"it passes, but was expected to fail ({self.expected_failed}); take it out of expected_failed"
        return Verdict(self.name, Kind.unexpected, text)


def check_expected(expected_failed: Mapping[str, str] | None, names: list[str]) -> Mapping[str, str]:
    """``expected_failed`` once every name is known and has a reason.

    Raises
    ------
    ValueError
        A name is none of ``names``, or has no reason; the text names the closest.
    """
    expected: dict[str, Any] = dict(expected_failed or {})
    for name, reason in expected.items():
        if name not in names:
            close = get_close_matches(name, names, n=1)
            hint = f" Did you mean {close[0]}?" if close else ""
            raise ValueError(f"expected_failed: there is no check {name!r}.{hint}")
        if not isinstance(reason, str) or not reason.strip():
            raise ValueError(f"expected_failed: {name} needs a reason, a sentence; got {reason!r}.")
    return expected
