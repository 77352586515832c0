"""Load one attribute of a Python file given by its path: ``my_file.py:problem``."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from difflib import get_close_matches
from pathlib import Path
from traceback import extract_tb
from types import ModuleType
from typing import Any

from hhtbench.protocol.errors import NotFoundError, ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.runtime.processes import WORKER

_EXECUTED: ContextVar[str] = ContextVar("executed", default="")  # the file that is being executed now


def load_attribute(path: str, name: str) -> Any:
    """Execute the file ``path`` (relative to the working folder) and return its attribute ``name``.

    Raises
    ------
    NotFoundError
        The file or the attribute does not exist.
    ProblemError
        The file cannot be read or raises when executed.
    """
    file = Path(path).expanduser()
    if not file.is_file():
        raise NotFoundError(f"there is no file {path} in {Path.cwd()}; {_neighbours(file)}")
    module = _module(file.resolve(), path)
    if not hasattr(module, name):
        raise NotFoundError(f"{path} has no attribute {name}; {_offer(module, name)}")
    return getattr(module, name)


def refuse_nested() -> None:
    """Raise if a campaign is started from a file that a campaign is loading or in a worker process (endless recursion).

    Raises
    ------
    ProblemError
        A file is being executed for one of its attributes, or this is a worker process.
    """
    file = _EXECUTED.get()
    if file or WORKER in os.environ:
        where = f"while {file} is loaded" if file else "in a worker process"
        raise ProblemError(f'hb.run and hb.trade cannot be called {where}; put the call under `if __name__ == "__main__":`.')


def _module(file: Path, shown: str) -> ModuleType:
    """Execute the file and return its module; the same content is executed once, so that its classes stay identical."""
    try:
        source = file.read_bytes()
    except OSError as error:
        raise ProblemError(f"{shown} cannot be read: {error.strerror}.") from error
    key = hashlib.sha256(str(file).encode() + b"\0" + source).hexdigest()[:16]
    name = f"hhtbench_file_{key}"  # never a name that an import statement could mean
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ProblemError(f"{shown} is not a Python file.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # before execution, as import does: dataclasses look their module up
    try:
        with _executed_at(file):
            exec(compile(source, str(file), "exec"), module.__dict__)
    except Exception as error:
        del sys.modules[name]
        raise ProblemError(f"{_place(file, error)} raised {type(error).__name__}: {error}") from error
    except BaseException:
        del sys.modules[name]
        raise
    return module


@contextmanager
def _executed_at(file: Path) -> Iterator[None]:
    """Context manager in which the file may import its neighbours: its folder is last on ``sys.path``, hiding nothing."""
    entry, token = str(file.parent), _EXECUTED.set(file.name)
    sys.path.append(entry)
    try:
        yield
    finally:
        _EXECUTED.reset(token)
        sys.path.reverse()
        sys.path.remove(entry)
        sys.path.reverse()


def _place(file: Path, error: Exception) -> str:
    """Return the file name and the file's own line that raised, not the line inside a library."""
    if isinstance(error, SyntaxError) and error.filename == str(file):
        return f"{file.name}, line {error.lineno},"
    lines = [frame.lineno for frame in extract_tb(error.__traceback__) if frame.filename == str(file)]
    return f"{file.name}, line {lines[-1]}," if lines else file.name


def _neighbours(file: Path) -> str:
    close = get_close_matches(file.name, [other.name for other in file.parent.glob("*.py")], n=1)
    return f"did you mean {file.with_name(close[0])}?" if close else "give the path as seen from there."


def _offer(module: ModuleType, name: str) -> str:
    close = get_close_matches(name, list(vars(module)), n=1)
    if close:
        return f"did you mean {close[0]}?"
    own = [
        key
        for key, value in vars(module).items()
        if isinstance(value, Problem) or getattr(value, "__module__", None) == module.__name__
    ]
    return f"it defines {', '.join(own) or 'no problem, function or class'}."
