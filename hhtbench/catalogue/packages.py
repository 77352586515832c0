"""Where the modules of distributions lie, also when a folder of the same name lies beside a user's script.

``solvers`` and ``problems`` are names that anybody may give to a folder.  Python has one package of a name: here it gets
both folders, so that the modules of both are found, as long as no module of the one has the name of one of the other.
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
    """See to it that Python finds the module of ``entry`` in its own distribution.

    Nothing of a user's is executed: where neither package is imported yet, it is the distribution's that will be.

    Raises
    ------
    ProblemError
        A user's file, or a module in a user's folder, has the name of one of the distribution's.
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
    """Import the distribution's package, whose modules are looked for in the users' folders too."""
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
    """Whether Python finds no file of the distribution's under the name of its package."""
    roots, found = _roots(entry), locations(entry.module.partition(".")[0])
    return bool(roots) and bool(found) and not any(place.is_relative_to(root) for place in found for root in roots)


def own_folder(entry: EntryPoint) -> Path | None:
    """The folder of the distribution's own top-level package; None where it has none."""
    top = entry.module.partition(".")[0]
    candidates = [folder / top for root in _roots(entry) for folder in (root, root / "src")]
    return next((folder for folder in candidates if (folder / "__init__.py").is_file()), None)


def own_folders(top: str, groups: tuple[str, ...]) -> tuple[Path, ...]:
    """The folders of all distributions that register something in a package of that name."""
    entries = (entry for group in groups for entry in entry_points(group=group) if entry.module.partition(".")[0] == top)
    return tuple(dict.fromkeys(folder for entry in entries if (folder := own_folder(entry)) is not None))


def locations(package: str) -> list[Path]:
    """Where Python finds a top-level package or module, without executing it."""
    spec = _spec(package)
    return [*_folders(package), *([Path(spec.origin).resolve()] if spec is not None and spec.origin else ())]


def _folders(package: str) -> list[Path]:
    """The folders of a package; none of a module that is a single file."""
    spec, module = _spec(package), sys.modules.get(package)
    known = None if module is None else getattr(module, "__path__", None)  # it can have grown since its import
    found = known if known is not None else (spec.submodule_search_locations if spec is not None else None)
    return [Path(place).resolve() for place in found or ()]


def owner(entry: EntryPoint) -> str:
    """Name and version of the distribution."""
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist is not None else "an unknown distribution"


def _spec(package: str) -> ModuleSpec | None:
    try:
        return importlib.util.find_spec(package)  # that of the imported module, where it is imported already
    except ValueError:  # a module made by hand has none
        return None


def _modules(folder: Path) -> set[str]:
    """Names that can be imported from a package's folder."""
    if not folder.is_dir():
        return set()
    files = {entry.stem for entry in folder.iterdir() if entry.suffix == ".py"}
    folders = {entry.name for entry in folder.iterdir() if entry.is_dir() and entry.name.isidentifier()}
    return (files | folders) - {"__init__", "__pycache__"}


@cache
def _origin(text: str) -> Path | None:
    """The project's folder of an editable distribution, from its direct_url.json."""
    origin = json.loads(text)
    if not origin.get("dir_info", {}).get("editable"):
        return None
    return Path(url2pathname(unquote(urlparse(origin["url"]).path))).resolve()


def _roots(entry: EntryPoint) -> list[Path]:
    """Folders that may hold the distribution's modules: where it is installed, or its project if editable."""
    if entry.dist is None:
        return []
    project = _origin(entry.dist.read_text("direct_url.json") or "{}")
    return [Path(str(entry.dist.locate_file(""))).resolve(), *([project] if project is not None else [])]
