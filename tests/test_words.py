"""Messages, docstrings and pages use the field's words; those below have a standard one, which stands beside them."""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SOURCES = [file for room in ("hhtbench", "solvers", "problems") for file in (ROOT / room).rglob("*.py")]
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *ROOT.glob("*/**/*.md")]
PAGES = sorted({page for page in PAGES if not {".venv", "build", "node_modules"} & set(page.parts)})
INSTEAD = {
    r"\btold\b|\bunto?ld\b": "reported, printed",
    r", in words\b(?! of)|\bin words[,;:]": "a sentence, as text",
    r"\blook(s|ed|ing)? at\b": "check, read",
    r"\bremarks?\b(?! \d)": "warning, note",
    r"\blagged\b": "stored (matrix)",
    r"\bheat\b|\bmade up\b|\bliars?\b|\bwish(es)?\b": "round, synthetic, faulty solver, criterion",
    r"\bgiv(e|es|en|ing) up\b": "dropped, ended",
}
NAMES = r"told|remark|lagged|slot|idle|leaps|unmet|heat|liar|wish|standing|suspect|distrust"


@functools.cache
def texts(file: Path) -> list[tuple[int, str]]:
    """Line and value of every string of a file: docstrings, messages, help."""
    if file.suffix != ".py":
        return list(enumerate(file.read_text(encoding="utf-8").splitlines(), 1))
    nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
    return [(node.lineno, node.value) for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)]


def names(file: Path) -> list[tuple[int, str]]:
    """Line and name of every function, class, argument and assigned variable."""
    found = []
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        name = getattr(node, "name", None) or getattr(node, "arg", None)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            name = node.id
        if isinstance(name, str):
            found.append((node.lineno, name))
    return found


@pytest.mark.parametrize("pattern", INSTEAD, ids=lambda pattern: INSTEAD[pattern])
def test_texts_use_the_words_of_the_field(pattern):
    said = re.compile(pattern, re.IGNORECASE)
    found = [
        f"{file.relative_to(ROOT)}:{line}: {match[0]}"
        for file in [*SOURCES, *PAGES]
        for line, text in texts(file)
        if (match := said.search(text))
    ]
    assert not found, f"say {INSTEAD[pattern]}:\n" + "\n".join(found)


def test_names_use_the_words_of_the_field():
    wrong = re.compile(rf"(?:^|_)(?:{NAMES})(?:s|$|_)")
    allowed = {"slot_rows", "__slots__"}  # a slot of a mechanism; Python's own
    found = [(file, *where) for file in SOURCES for where in names(file) if where[1] not in allowed]
    found = [f"{file.relative_to(ROOT)}:{line}: {name}" for file, line, name in found if wrong.search(name)]
    assert not found, "\n".join(found)
