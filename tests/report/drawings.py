"""What a page of a report has embedded."""

from __future__ import annotations

import base64
import gzip
import json
import re
from typing import Any

PACKED = re.compile(r'<script type="application/gzip"(?: id="([^"]*)")?>([A-Za-z0-9+/=]*)</script>')


def embedded(page: str, name: str) -> str:
    """The text of the packed script ``name``."""
    (found,) = [text for own, text in scripts_of(page) if own == name]
    return found


def scripts_of(page: str) -> list[tuple[str, str]]:
    """Id, "" where it has none, and text of each packed script."""
    return [(name, gzip.decompress(base64.b64decode(content)).decode()) for name, content in PACKED.findall(page)]


def opened(page: str) -> str:
    """The page as a browser holds it when all of its parts are opened, without figures."""

    def html(found: re.Match[str]) -> str:
        ((name, text),) = scripts_of(found[0])
        return "" if name == "plotly" else str(json.loads(text)["html"])

    return PACKED.sub(html, page)


def figures_of(page: str) -> dict[int, Any]:
    """By their numbers; a number that is not finite is a mistake."""

    def refuse(text: str) -> Any:
        raise ValueError(f"{text} is not JSON")

    found = {}
    for name, text in scripts_of(page):
        if name != "plotly":
            part = json.loads(text, parse_constant=refuse)
            found |= {int(number): _completed(figure, part["texts"]) for number, figure in part["figures"].items()}
    return found


def _completed(value: Any, texts: list[str]) -> Any:
    if isinstance(value, dict):
        return texts[value["$"]] if "$" in value else {name: _completed(part, texts) for name, part in value.items()}
    return [_completed(part, texts) for part in value] if isinstance(value, list) else value
