"""Convert a row to the texts of its columns and back, and hash them."""

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
    """Decode the bytes of the columns to a row; None if they are damaged."""
    try:
        found = dict(zip(COLUMNS, texts, strict=True))
        found[PACKED] = zlib.decompress(found[PACKED])
        values = {name: text.decode() for name, text in found.items()}
        del values["identity"]
        return RunRow(**{k: json.loads(v) if k in JSON_COLUMNS else v for k, v in values.items()})
    except (ValueError, AttributeError, TypeError, zlib.error):
        return None


def texts_of(row: RunRow, identity: str) -> list[str | bytes]:
    """Encode a row as text columns, ``PACKED`` as bytes; a number that is not finite is an error of the caller."""
    values: dict[str, Any] = {**vars(row), "identity": identity}
    texts = [json.dumps(values[k], allow_nan=False) if k in JSON_COLUMNS else str(values[k]) for k in COLUMNS]
    content = [text.encode("utf-8", "backslashreplace") for text in texts]  # names of files need not be UTF-8
    return [zlib.compress(part, 1) if name == PACKED else part.decode() for name, part in zip(COLUMNS, content, strict=True)]


def hash_of(texts: Iterable[Any]) -> str:
    """Hash the columns' lengths and texts; the lengths prevent that text moves between columns unnoticed."""
    digest = hashlib.sha256()
    for text in texts:
        content = text.encode() if isinstance(text, str) else text if isinstance(text, bytes) else repr(text).encode()
        digest.update(len(content).to_bytes(8, "little") + content)
    return digest.hexdigest()


def shown(value: Any) -> str:
    """Decode the content of a damaged column as text."""
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)
