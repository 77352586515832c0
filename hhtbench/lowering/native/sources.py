"""A name for a computation that is known without tracing it: everything its meaning depends on, hashed.

What is hashed: the description of the dynamics without parameter values (:mod:`.describing`), the sources of every module
its classes and functions come from and of all modules those import, as far as these are not of the standard library or
installed packages, the functions and simple constants that these modules hold now (they may have been replaced), the
versions of the libraries, and the processor.  Where any of it cannot be told there is no name, and the computation is
traced.
"""

from __future__ import annotations

import hashlib
import re
import sys
import sysconfig
import time
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

import equinox
import jax
import jaxlib
import numpy as np

from hhtbench.lowering.native.describing import NotDescribed, bytecode, describe
from hhtbench.lowering.native.machine import host

LARGEST_CONSTANT = 10_000  # entries of a module-level array that are read; who keeps more in a module gets no name
OWN = "hhtbench.lowering."  # always looked at, as a whole: what is traced and how code is written is decided there
STEADY = ("hhtbench.", "solvers.")  # nobody replaces what these modules hold: their files are enough
NUMBERLESS = ("__future__", "typing", "logging", "re", "collections.abc")  # no value of their types can enter a formula
FOREIGN = frozenset({"equinox", "jax", "jaxlib", "numpy", "scipy"}) | sys.stdlib_module_names - {"__main__"}
STARTED = time.time()  # a file changed after that may not be what this process runs
_IMPORT = re.compile(r"^[ \t]*(?:from[ \t]+([.\w]+)[ \t]+import[ \t]+\(?([^#\n]*)|import[ \t]+([^#\n]+))", re.MULTILINE)
_LIBRARIES = tuple(
    sorted({str(Path(sysconfig.get_paths()[key]).resolve()) for key in ("stdlib", "platstdlib", "purelib", "platlib")})
)


def source_key(function: Any, dynamics: Any, static: tuple[Any, ...], more: tuple[Any, ...]) -> str | None:
    """A hash for ``function(dynamics, *static, ...)``, or None where the meaning of a part cannot be told."""
    modules: set[str] = set()
    try:
        described = describe((function, static), modules, parameters=False), describe(dynamics, modules, parameters=True)
        state = _modules(modules)
    except (NotDescribed, RecursionError):  # what holds itself has no end
        return None
    digest = hashlib.sha256()
    for part in (described, more, state, _versions()):
        digest.update(repr(part).encode() + b"\0")
    return digest.hexdigest()


@lru_cache
def _versions() -> tuple[str, ...]:
    return host(), jax.__version__, jaxlib.__version__, equinox.__version__, np.__version__, sys.version


def _modules(names: set[str]) -> list[Any]:
    """Every module the named ones reach, with the hash of its file and what it holds now."""
    roots = {name.partition(".")[0] for name in names} - FOREIGN
    reached: dict[str, Any] = {}
    waiting = [*names, "hhtbench.lowering"]
    while waiting:
        name = waiting.pop()
        if name in reached or name.startswith(OWN):
            continue
        module = sys.modules.get(name)
        if module is None:
            raise NotDescribed(f"the module {name} is not loaded")
        if name == "hhtbench.lowering":
            reached[name], imported = _own()
            waiting += [candidate for candidate in imported if candidate in sys.modules]
            continue
        if not _is_users(module, roots):
            reached[name] = _installed(name.partition(".")[0])
            continue
        path = _path(module)
        content, imported = _source(path, name, _changed(path))
        reached[name] = content, () if name.startswith(STEADY) else _contents(module)
        bound = [value.__name__ for value in vars(module).values() if isinstance(value, ModuleType)]
        waiting += [candidate for candidate in (*imported, *bound) if candidate in sys.modules]
    return sorted(reached.items())


def _is_users(module: ModuleType, roots: set[str]) -> bool:
    """Whether the sources of a module must be read: not those of installed packages, unless the system is from there."""
    if module.__name__.partition(".")[0] in roots:
        return True
    file = getattr(module, "__file__", None)
    return file is not None and not _is_library(file)  # without a file: built in, frozen, or a folder without code


@lru_cache(maxsize=4096)
def _is_library(file: str) -> bool:
    return str(Path(file).resolve()).startswith(_LIBRARIES)


@lru_cache(maxsize=1024)
def _installed(package: str) -> str:
    """Enough of an installed package to see that it was replaced."""
    module = sys.modules.get(package)
    file = getattr(module, "__file__", None)
    changed = Path(file).stat().st_mtime_ns if file and Path(file).exists() else 0
    return f"{getattr(module, '__dict__', {}).get('__version__', '')} {changed}"


def _path(module: ModuleType) -> Path:
    file = getattr(module, "__file__", None)
    if file is None or not file.endswith(".py") or not Path(file).is_file():
        raise NotDescribed(f"the source of {module.__name__} is not there")
    return Path(file)


def _changed(path: Path) -> int:
    stat = path.stat()
    if max(stat.st_mtime, stat.st_ctime) >= STARTED:
        raise NotDescribed(f"{path} was changed after this process began")
    return stat.st_mtime_ns


@lru_cache(maxsize=1)
def _own() -> tuple[str, tuple[str, ...]]:
    """Hash of all of ``hhtbench.lowering``, loaded or not, and what it imports from elsewhere."""
    folder = Path(__file__).resolve().parents[1]
    found = [_source(path, "hhtbench.lowering.any", _changed(path)) for path in sorted(folder.rglob("*.py"))]
    imported = {name for _, names in found for name in names if not name.startswith("hhtbench.lowering")}
    return hashlib.sha256("".join(content for content, _ in found).encode()).hexdigest(), tuple(sorted(imported))


@lru_cache(maxsize=1024)
def _source(path: Path, name: str, changed: int) -> tuple[str, tuple[str, ...]]:
    """Hash of a source file, and the modules it imports, anywhere in it."""
    data = path.read_bytes()
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    found = []
    for source, names, plain in _IMPORT.findall(data.decode(errors="replace")):
        if plain:
            found += [part.split()[0] for part in plain.split(",") if part.strip()]
            continue
        base = _absolute(source, package)
        found += [base, *(f"{base}.{part.split()[0]}" for part in names.replace(")", "").split(",") if part.strip())]
    return hashlib.sha256(data).hexdigest(), tuple(found)


def _absolute(source: str, package: str) -> str:
    dots = len(source) - len(source.lstrip("."))
    if not dots:
        return source
    parts = package.split(".")
    base = parts[: len(parts) - dots + 1]
    return ".".join([*base, *([source[dots:]] if source[dots:] else [])])


def _contents(module: ModuleType) -> list[Any]:
    """What a module holds now: it may have been read from elsewhere, or replaced since.

    Raises
    ------
    NotDescribed
        There is something whose meaning cannot be told.
    """
    found: list[Any] = []
    for name, value in sorted(vars(module).items()):
        if name.startswith("__"):
            continue
        if isinstance(value, bool | int | float | complex | str | bytes | tuple | np.ndarray | jax.Array):
            if getattr(value, "size", 0) > LARGEST_CONSTANT:
                raise NotDescribed(f"{module.__name__}.{name} is a large array")
            found.append((name, _constant(value)))
        elif getattr(value, "__module__", None) == module.__name__ and callable(value):
            found.append((name, bytecode(value)))
        elif not isinstance(value, ModuleType) and not _is_named(value):
            found.append((name, describe(value, set(), parameters=False)))
    return found


def _is_named(value: Any) -> bool:
    """A class or function of another module: what it means is told there."""
    name = str(getattr(value, "__module__", ""))
    found = getattr(sys.modules.get(name), getattr(value, "__name__", ""), None)
    named = callable(value) and (found is value or name.partition(".")[0] in FOREIGN)
    return named or type(value).__module__ in NUMBERLESS


def _constant(value: Any) -> Any:
    if isinstance(value, np.ndarray | jax.Array):
        array = np.asarray(value)
        return str(array.dtype), array.shape, array.tobytes()
    if isinstance(value, tuple):
        return tuple(_constant(part) for part in value)
    return repr(value) if isinstance(value, bool | int | float | complex | str | bytes) else type(value).__qualname__
