"""Find the modules of installed distributions even if a folder of the same name lies beside a user's script.

``solvers`` and ``problems`` are names that anybody may give to a folder, and Python imports one package of a name.  Here
that package gets both folders, so that the modules of both are found, unless both have a module of the same name.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import sys
from functools import cache
from importlib.machinery import ModuleSpec
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from urllib.parse import unquote, urlparse
from urllib.request import url2pathname

from hhtbench.protocol.errors import ProblemError


def make_findable(entry: EntryPoint) -> None:
    """Make sure that Python imports the module of ``entry`` from its own distribution and not from a user's folder.

    No user's file is executed: if neither package is imported yet, the distribution's is imported.

    Raises
    ------
    ProblemError
        A user's file hides the package, or both folders have a module of the same name.
    """
    top = entry.module.partition(".")[0]
    if not hidden(entry):
        return
    own, theirs = own_folder(entry), _folders(top)
    alike = sorted(_modules(own) & set().union(*map(_modules, theirs))) if own is not None else []
    if own is None or not theirs or alike:
        names = f"; both have {', '.join(alike)}" if alike else ""
        raise ProblemError(
            f"{entry.group.removeprefix('hhtbench.').removesuffix('s')} {entry.name}: {owner(entry)} means its own "
            f"{entry.module}, but Python finds {', '.join(map(str, locations(top)))} first, which hides it{names}. "
            f"Rename that file or folder, or run from elsewhere."
        )
    if top in sys.modules:
        sys.modules[top].__path__ = [*map(str, theirs), str(own)]
    else:
        _import_package(top, own, theirs)


def _import_package(top: str, own: Path, theirs: list[Path]) -> None:
    """Import the distribution's package with the users' folders appended to its ``__path__``."""
    folders = [str(own), *map(str, theirs)]
    spec = importlib.util.spec_from_file_location(top, own / "__init__.py", submodule_search_locations=folders)
    if spec is None or spec.loader is None:
        raise ProblemError(f"Python cannot import {own}.")
    sys.modules[top] = module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[top]
        raise


def hidden(entry: EntryPoint) -> bool:
    """True if a user's file or folder hides the distribution's package of the same name."""
    roots, found = _roots(entry), locations(entry.module.partition(".")[0])
    return bool(roots) and bool(found) and not any(place.is_relative_to(root) for place in found for root in roots)


def own_folder(entry: EntryPoint) -> Path | None:
    """Return the folder of the distribution's own top-level package; None if it has none."""
    top = entry.module.partition(".")[0]
    candidates = [folder / top for root in _roots(entry) for folder in (root, root / "src")]
    return next((folder for folder in candidates if (folder / "__init__.py").is_file()), None)


def own_folders(top: str, groups: tuple[str, ...]) -> tuple[Path, ...]:
    """Return the package folders named ``top`` of all distributions that register entry points of ``groups`` in it."""
    entries = (entry for group in groups for entry in entry_points(group=group) if entry.module.partition(".")[0] == top)
    return tuple(dict.fromkeys(folder for entry in entries if (folder := own_folder(entry)) is not None))


def locations(package: str) -> list[Path]:
    """Return the paths where Python finds a top-level package or module, without executing it."""
    spec = _spec(package)
    return [*_folders(package), *([Path(spec.origin).resolve()] if spec is not None and spec.origin else ())]


def _folders(package: str) -> list[Path]:
    """Return the folders of a package; an empty list for a module that is a single file."""
    spec, module = _spec(package), sys.modules.get(package)
    known = None if module is None else getattr(module, "__path__", None)  # it can have grown since its import
    found = known if known is not None else (spec.submodule_search_locations if spec is not None else None)
    return [Path(place).resolve() for place in found or ()]


def owner(entry: EntryPoint) -> str:
    """Return name and version of the distribution that registers ``entry``."""
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist is not None else "an unknown distribution"


def _spec(package: str) -> ModuleSpec | None:
    try:
        return importlib.util.find_spec(package)  # that of the imported module, where it is imported already
    except ValueError:  # a module made by hand has none
        return None


def _modules(folder: Path) -> set[str]:
    """Return the names of the modules and subpackages in a package's folder."""
    if not folder.is_dir():
        return set()
    files = {entry.stem for entry in folder.iterdir() if entry.suffix == ".py"}
    folders = {entry.name for entry in folder.iterdir() if entry.is_dir() and entry.name.isidentifier()}
    return (files | folders) - {"__init__", "__pycache__"}


@cache
def _origin(text: str) -> Path | None:
    """Return the project folder of an editable installation from the text of its direct_url.json; else None."""
    origin = json.loads(text)
    if not origin.get("dir_info", {}).get("editable"):
        return None
    return Path(url2pathname(unquote(urlparse(origin["url"]).path))).resolve()


def _roots(entry: EntryPoint) -> list[Path]:
    """Return the folders that may hold the distribution's modules: site-packages, and the project folder if editable."""
    if entry.dist is None:
        return []
    project = _origin(entry.dist.read_text("direct_url.json") or "{}")
    return [Path(str(entry.dist.locate_file(""))).resolve(), *([project] if project is not None else [])]
