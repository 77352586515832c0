"""Find the entry points that distributions register, and import one of them at a time."""

from __future__ import annotations

import ast
import importlib
import sys
from functools import reduce
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from hhtbench.catalogue.packages import locations, make_findable, own_folder, owner
from hhtbench.protocol.errors import NotFoundError, ProblemError, did_you_mean

GROUPS = {
    "problem": "hhtbench.problems",
    "solver": "hhtbench.solvers",
    "verification": "hhtbench.verifications",
    "reference": "hhtbench.references",
    "name": "hhtbench.names",
}

METHODS = {  # names of methods -> how to ask for them: "did you mean" for unknown solvers
    "dop853": "projected(method=DOP853) or scipy(method=DOP853)",
    **dict.fromkeys(("rk45", "rk23", "rk4"), "projected(method=RK45)"),
    **{name.lower(): f"scipy(method={name})" for name in ("Radau", "BDF", "LSODA")},
    **{name.lower(): f"diffrax(method={name})" for name in ("Tsit5", "Dopri8", "Kvaerno5")},
    "adams": "cvode(method=adams)",
    "sundials": "ida or cvode",
}

_loaded: dict[tuple[str, str], tuple[Any, str, ModuleType, Any]] = {}  # reading all distributions takes two milliseconds


def names(kind: str) -> list[str]:
    """Return the sorted names registered for ``kind``, a key of ``GROUPS``; nothing is imported."""
    return sorted({entry.name for entry in entry_points(group=GROUPS[kind])})


def find(kind: str, name: str) -> EntryPoint:
    """Return the only entry point of that name.

    Raises
    ------
    NotFoundError
        There is none; the text names the closest.
    ProblemError
        Several distributions register the name.
    """
    found = list(entry_points(group=GROUPS[kind], name=name))
    if not found:
        raise NotFoundError(_unknown(kind, name))
    if len(found) > 1:
        owners = " and ".join(sorted(f"{owner(entry)} ({entry.value})" for entry in found))
        raise ProblemError(f"the {kind} {name} is registered more than once: by {owners}. Uninstall one of them.")
    return found[0]


def load(kind: str, name: str) -> Any:
    """Import the module behind ``name``, and no other, and return the registered object."""
    where = tuple(sys.path)  # with other folders the name may be another's, or several distributions'
    known = _loaded.get((kind, name))
    if known is not None and known[0] == where and sys.modules.get(known[1]) is known[2]:
        return known[3]
    entry = find(kind, name)
    found, module = _imported(kind, name, entry)
    _loaded[kind, name] = where, entry.module, module, found
    return found


def _imported(kind: str, name: str, entry: EntryPoint) -> tuple[Any, ModuleType]:
    """Import the entry point's module and return the registered object and the module."""
    make_findable(entry)
    try:
        module = importlib.import_module(entry.module)
    except Exception as error:
        raise ProblemError(
            f"the {kind} {name} of {owner(entry)} cannot be imported: {type(error).__name__}: {error}. "
            f"Python found {entry.module.partition('.')[0]} at {_places(entry.module)}."
        ) from error
    try:
        return reduce(getattr, filter(None, entry.attr.split(".")), module), module
    except AttributeError as error:
        raise ProblemError(f"the {kind} {name} of {owner(entry)}: {error} (file {_file(module)}).") from error


def summaries(kind: str) -> dict[str, str]:
    """Return the sorted names with the first lines of their modules' docstrings ("" if none); nothing is imported."""
    found: dict[str, list[EntryPoint]] = {}
    for entry in entry_points(group=GROUPS[kind]):  # once: it reads what every distribution registers
        found.setdefault(entry.name, []).append(entry)
    return {name: _summary(entries) for name, entries in sorted(found.items())}


def _summary(entries: list[EntryPoint]) -> str:
    if len(entries) != 1:
        return f"registered by {' and '.join(sorted(owner(entry) for entry in entries))}: not usable"
    top, *rest = entries[0].module.split(".")
    for folder in filter(None, [own_folder(entries[0]), *locations(top)]):
        base = folder.joinpath(*rest) if rest else folder
        for file in (base.with_suffix(".py"), base / "__init__.py", base):
            if file.is_file():
                return _first_line(file)
    return ""


def _first_line(file: Path) -> str:
    try:
        text = ast.get_docstring(ast.parse(file.read_bytes()))
    except (SyntaxError, ValueError, OSError):
        return ""
    return text.splitlines()[0] if text else ""


def _unknown(kind: str, name: str) -> str:
    known = names(kind)
    text = f"there is no {kind} named {name!r}."
    if not known:
        return f"{text} None is registered: is the distribution installed (pip install -e .)?"
    method = METHODS.get(name.lower()) if kind == "solver" else None
    text += f" Did you mean {method}?" if method else did_you_mean(name, known)
    file = f"; a file is named as FILE.py:{name}" if kind in ("problem", "solver") else ""
    return f"{text} `hhtbench list` shows all{file}."


def _places(module: str) -> str:
    return ", ".join(str(place) for place in locations(module.partition(".")[0])) or "no file"


def _file(module: ModuleType) -> str:
    return str(getattr(module, "__file__", None) or "unknown")
