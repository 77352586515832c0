"""What a page of a report has embedded."""

from __future__ import annotations

import base64
import gzip
import json
import re
from typing import Any


def embedded(page: str, name: str) -> str:
    """The text of the packed script ``name``: "figures" or "plotly"."""
    (content,) = re.findall(rf'<script type="application/gzip" id="{name}">([A-Za-z0-9+/=]*)</script>', page)
    return gzip.decompress(base64.b64decode(content)).decode()


def figures_of(page: str) -> list[Any]:
    """In the order of the page; a number that is not finite is a mistake."""

    def refuse(text: str) -> Any:
        raise ValueError(f"{text} is not JSON")

    found: list[Any] = json.loads(embedded(page, "figures"), parse_constant=refuse)
    return found
