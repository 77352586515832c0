"""A row as the texts of its columns, and their hash."""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Iterable
from typing import Any

from hhtbench.campaign.store.rows import RunRow

JSON_COLUMNS = ("request", "metrics", "series", "counters", "timing", "environment")
PACKED = "series"  #: the column that is compressed: nine tenths of a row
COLUMNS = (
    "key",
    "identity",
    "problem",
    "solver",
    "request",
    "status",
    "message",
    "metrics",
    "series",
    "counters",
    "timing",
    "environment",
    "created",
)  #: all but the hash


def row_of(texts: list[Any]) -> RunRow | None:
    """The row whose columns hold these bytes; None where they hold none."""
    try:
        found = dict(zip(COLUMNS, texts, strict=True))
        found[PACKED] = zlib.decompress(found[PACKED])
        values = {name: text.decode() for name, text in found.items()}
        del values["identity"]
        return RunRow(**{k: json.loads(v) if k in JSON_COLUMNS else v for k, v in values.items()})
    except (ValueError, AttributeError, TypeError, zlib.error):
        return None


def texts_of(row: RunRow, identity: str) -> list[str | bytes]:
    """The columns as text, ``PACKED`` as bytes; a number that is not finite is a mistake of the caller."""
    values: dict[str, Any] = {**vars(row), "identity": identity}
    texts = [json.dumps(values[k], allow_nan=False) if k in JSON_COLUMNS else str(values[k]) for k in COLUMNS]
    content = [text.encode("utf-8", "backslashreplace") for text in texts]  # names of files need not be UTF-8
    return [zlib.compress(part, 1) if name == PACKED else part.decode() for name, part in zip(COLUMNS, content, strict=True)]


def hash_of(texts: Iterable[Any]) -> str:
    """Over the lengths and texts, so that nothing moves from one column into the next."""
    digest = hashlib.sha256()
    for text in texts:
        content = text.encode() if isinstance(text, str) else text if isinstance(text, bytes) else repr(text).encode()
        digest.update(len(content).to_bytes(8, "little") + content)
    return digest.hexdigest()


def shown(value: Any) -> str:
    """What a damaged column holds, as text."""
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)
