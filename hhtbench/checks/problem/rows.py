"""Helpers of the problem check: guarded calls, and rows for what could not be measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from hhtbench.protocol.errors import NonFiniteValue, ProblemError
from hhtbench.protocol.evidence import Row

MAX_CHARACTERS = 240  # characters of a reason; a library's message may run over pages


@dataclass(frozen=True)
class Attempted:
    """Result of a guarded call: a value, or the reason why there is none."""

    value: Any = None
    fault: str = ""


def attempt(action: Callable[[], Any]) -> Attempted:
    """Call ``action``; an exception becomes a reason, so that the other rows are still measured."""
    try:
        return Attempted(value=action())
    except Exception as error:  # noqa: BLE001 - a check lists every fault instead of stopping at the first
        return Attempted(fault=reason_of(error))


def reason_of(error: Exception) -> str:
    """Return the first line of an error, with its type unless it is one of hhtbench's own."""
    line = next(iter(str(error).strip().splitlines()), "")[:MAX_CHARACTERS]
    if isinstance(error, (ProblemError, NonFiniteValue)) and line:
        return line
    return f"{type(error).__name__}: {line}" if line else type(error).__name__


def not_measured(row_id: str, claim: str, bound: str, reason: str) -> Row:
    """Return a failed row for something that cannot be measured because of another fault."""
    return Row(id=row_id, claim=claim, measured=f"not measured: {reason}", bound=bound, passed=False)


def yes_or_fault(row_id: str, claim: str, fault: str, good: str, bound: str) -> Row:
    """Return a row that passes if ``fault`` is empty."""
    return Row(id=row_id, claim=claim, measured=fault or good, bound=bound, passed=not fault)
