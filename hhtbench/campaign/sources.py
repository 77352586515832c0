"""Find the files and libraries that a result depends on by reading import statements, without importing anything."""

from __future__ import annotations

import ast
import hashlib
import platform
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path

from hhtbench.catalogue import plugins
from hhtbench.catalogue.packages import locations, own_folders
from hhtbench.catalogue.registry import is_held
from hhtbench.catalogue.specs import Spec

NUMERICS = ("hhtbench.campaign.run",)  #: what turns problem and solver into numbers; its imports are followed
ALWAYS = ("numpy", "scipy", "jax", "jaxlib", "equinox")
NOT_DATA = {".py", ".pyc", ".md", ".html", ".png", ".svg", ".gif", ".db"}  # nor stores: .sqlite, .sqlite-wal


@dataclass(frozen=True)
class _Module:
    """One Python file with its dotted module name."""

    name: str
    file: Path
    root: Path | None  #: folder whose files it may import by bare names (a user's file); None: an installed module


@dataclass(frozen=True)
class _Read:
    """Digest, imports and string constants of one file."""

    digest: str
    imports: tuple[str, ...]  #: dotted names; for ``from a import b`` both ``a`` and ``a.b``
    words: frozenset[str]  #: its string constants


class SourceReader:
    """Cache that reads every file once and follows the imports of every problem and solver once; make one per plan."""

    def __init__(self) -> None:
        self._read: dict[Path, _Read] = {}
        self._modules: dict[str, _Module | None] = {}
        self._folders: dict[str, tuple[Path, ...]] = {}
        self._starts: dict[tuple[str, str], _Module | None] = {}
        self._behind: dict[_Module, dict[str, str]] = {}

    def behind(self, problem: Spec, solver: Spec) -> dict[str, str]:
        """Return content hashes of all files and versions of all libraries that a run of ``solver`` on ``problem`` depends
        on.
        """
        found: dict[str, str] = {}
        starts = [self._start("problem", problem), self._start("solver", solver), *map(self._module, NUMERICS)]
        for start in filter(None, starts):
            found.update(self._followed(start))
        libraries = {*ALWAYS, *(name.removeprefix("library ") for name in found if name.startswith("library "))}
        found.update({f"library {name}": _version_of(name) for name in libraries})
        return {**found, "python": ".".join(platform.python_version_tuple()[:2])}

    def _followed(self, start: _Module) -> dict[str, str]:
        """Return hashes by name of ``start``, its data files and all modules that it imports, directly or not.

        A library has the entry "library NAME" with an empty text. The result is remembered.
        """
        if start not in self._behind:
            self._behind[start] = self._follow(start)
        return self._behind[start]

    def _follow(self, start: _Module) -> dict[str, str]:
        own = {start.name.partition(".")[0], "hhtbench"}
        found = dict(self._data(start))
        waiting = [start]
        while waiting:
            module = waiting.pop()
            if module.name in found:
                continue
            read = self._reading(module)
            found[module.name] = read.digest
            for name in read.imports:
                top = name.partition(".")[0]
                inner = _neighbour(module.root, name) or (self._module(name) if top in own else None)
                if inner is not None:
                    waiting.append(inner)
                elif top not in own and _is_library(top):
                    found[f"library {top}"] = ""
        return found

    def _start(self, kind: str, spec: Spec) -> _Module | None:
        if spec.path is not None:
            file = Path(spec.path).expanduser()
            return _Module(spec.path, file, file.parent) if file.is_file() else None
        if kind == "problem" and is_held(spec.name):
            return None
        if (kind, spec.name) not in self._starts:  # finding a name reads all distributions, 20 ms
            self._starts[kind, spec.name] = self._module(plugins.find(kind, spec.name).module)
        return self._starts[kind, spec.name]

    def _module(self, name: str) -> _Module | None:
        if name not in self._modules:
            top = name.partition(".")[0]
            if top not in self._folders:
                self._folders[top] = _folders(top)
            self._modules[name] = _find(name, self._folders[top])
        return self._modules[name]

    def _reading(self, module: _Module) -> _Read:
        if module.file not in self._read:
            package = module.name if module.file.name == "__init__.py" else module.name.rpartition(".")[0]
            self._read[module.file] = _read(module.file.read_bytes(), package)
        return self._read[module.file]

    def _data(self, module: _Module) -> Iterator[tuple[str, str]]:
        """Yield name and hash of the data files in the module's folder whose name the module mentions."""
        words = self._reading(module).words
        inner = (f for f in module.file.parent.iterdir() if f.is_dir() and f.suffix != ".references")  # beside a store
        folders = [module.file.parent, *inner]
        for folder in folders:
            for file in sorted(folder.iterdir()):
                if file.suffix in NOT_DATA or file.suffix.startswith(".sqlite"):
                    continue
                if (file.name in words or file.stem in words) and file.is_file():
                    name = file.relative_to(module.file.parent).as_posix()
                    yield f"{module.name}: {name}", hashlib.sha256(file.read_bytes()).hexdigest()


@lru_cache(maxsize=1024)  # a process that plans again parses only what has changed
def _read(text: bytes, package: str) -> _Read:
    """Parse the ``text`` of a module in ``package``."""
    digest = hashlib.sha256(text).hexdigest()
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError):
        return _Read(digest, (), frozenset())
    words = {n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str)}
    return _Read(digest, tuple(_imports(tree, package)), frozenset(words))


def _find(name: str, folders: tuple[Path, ...]) -> _Module | None:
    """Return the file of a dotted module name whose first part lies in ``folders``; None if there is no file.

    ``hhtbench`` itself gives None, since it only re-exports.
    """
    rest = name.split(".")[1:]
    if name == "hhtbench":
        return None
    for base in folders:
        file = base if not rest and base.is_file() else _file_at(base.joinpath(*rest))
        if file is not None:
            return _Module(name, file, None)
    return None


def _file_at(place: Path) -> Path | None:
    """Return the module's ``.py`` file or the package's ``__init__.py``; None if neither exists."""
    return next((f for f in (place.with_name(f"{place.name}.py"), place / "__init__.py") if f.is_file()), None)


def _folders(top: str) -> tuple[Path, ...]:
    """Return the places of a top-level package or module without importing it, a distribution's before a user's."""
    return tuple(dict.fromkeys((*own_folders(top, tuple(plugins.GROUPS.values())), *locations(top))))


def _neighbour(root: Path | None, name: str) -> _Module | None:
    """Return the file beside a user's file that it imports by the bare ``name``; None if there is none."""
    file = None if root is None else _file_at(root.joinpath(*name.split(".")))
    return None if file is None else _Module(name, file, root)


def _imports(tree: ast.AST, package: str) -> Iterator[str]:
    """Yield the names imported anywhere in ``tree``, except under ``TYPE_CHECKING``."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            name = ".".join([*base, *([node.module] if node.module else [])])
            yield name
            yield from (f"{name}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            yield from (name for rest in node.orelse for name in _imports(rest, package))
        else:
            yield from _imports(node, package)


@cache
def _owners() -> dict[str, list[str]]:
    return dict(packages_distributions())


def _is_library(top: str) -> bool:
    return top in _owners()


@cache
def _version_of(top: str) -> str:
    try:
        return ", ".join(sorted({f"{name} {version(name)}" for name in _owners().get(top, [top])}))
    except PackageNotFoundError:
        return "not installed"
