"""What every part of the check uses: guarded calls and rows for what could not be measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from hhtbench.protocol.errors import NonFiniteValue, ProblemError
from hhtbench.protocol.evidence import Row

MAX_CHARACTERS = 240  # characters of a reason; a library's message may run over pages


@dataclass(frozen=True)
class Attempted:
    """What a guarded call gave: a value, or the reason why there is none."""

    value: Any = None
    fault: str = ""


def attempt(action: Callable[[], Any]) -> Attempted:
    """Call ``action``; whatever a user's function raises becomes a reason, so that the other rows are still measured."""
    try:
        return Attempted(value=action())
    except Exception as error:  # noqa: BLE001 - a check lists every fault instead of stopping at the first
        return Attempted(fault=reason_of(error))


def reason_of(error: Exception) -> str:
    """The first line of an error; our own errors need no type."""
    line = next(iter(str(error).strip().splitlines()), "")[:MAX_CHARACTERS]
    if isinstance(error, (ProblemError, NonFiniteValue)) and line:
        return line
    return f"{type(error).__name__}: {line}" if line else type(error).__name__


def not_measured(row_id: str, claim: str, bound: str, reason: str) -> Row:
    """A row that counts as failed because something it rests on failed."""
    return Row(id=row_id, claim=claim, measured=f"not measured: {reason}", bound=bound, passed=False)


def yes_or_fault(row_id: str, claim: str, fault: str, good: str, bound: str) -> Row:
    """A row that holds where there is no fault."""
    return Row(id=row_id, claim=claim, measured=fault or good, bound=bound, passed=not fault)
