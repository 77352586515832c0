"""Load problems, solvers and verifications by name, from a file or as objects; modules are imported when asked for."""

from __future__ import annotations

import inspect
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from hhtbench.catalogue import plugins
from hhtbench.catalogue.packages import own_folder
from hhtbench.catalogue.specs import Spec, parse_spec
from hhtbench.protocol.errors import ProblemError, did_you_mean
from hhtbench.protocol.problem import Problem, Solver
from hhtbench.protocol.system import NumpySystem, System, declared

if TYPE_CHECKING:
    from hhtbench.protocol.evidence import Evidence

Counted = Callable[[str, int, int], None]  #: progress: name of the items, number done, number in all
Verification = Callable[[Counted | None, int], "Evidence"]  # (progress, jobs); rows do not depend on jobs

_HELD: ContextVar[Mapping[str, Problem]] = ContextVar("held", default=MappingProxyType({}))  # name -> problem

_lock = threading.Lock()
_systems: dict[str, System] = {}  # spec -> the System it made last
MAX_SYSTEMS = 16  # stored: each holds its arrays and compiled functions

THUMBNAILS = "thumbnails"  # folder with drawings, beside the problems


def list_problems() -> list[str]:
    """Return the names that :func:`load_problem` accepts."""
    return plugins.names("problem")


def list_solvers() -> list[str]:
    """Return the names that :func:`load_solver` accepts."""
    return plugins.names("solver")


def list_verifications() -> list[str]:
    """Return the names that :func:`load_verification` accepts."""
    return plugins.names("verification")


def load_problem(spec: str | Problem, **parameters: Any) -> Problem:
    """Load the problem of a spec, ``planar_chain(n_links=100)`` or ``my_file.py:problem(k=1)``; return a Problem as it is.

    If the spec's System equals the one it made before, the earlier object is used, so that compiled code is reused.

    Parameters
    ----------
    spec
        A name of :func:`list_problems` or a file with the attribute that holds a Problem or a function which
        returns one.
    parameters
        Further keyword arguments of that function.

    Raises
    ------
    NotFoundError
        The name, file or attribute does not exist.
    ProblemError
        The spec cannot be read, a parameter is unknown or given twice, or no Problem came out.
    """
    if isinstance(spec, Problem):
        if parameters:
            _refuse_arguments(f"the problem {spec.name}", parameters)
        return spec
    if isinstance(spec, (System, NumpySystem)):
        from hhtbench.protocol.wrong_use import system_as_problem

        raise system_as_problem(spec)
    if is_held(spec):
        return _HELD.get()[spec]
    found = parse_spec(spec)
    made = _make("problem", found, parameters)
    if not isinstance(made, Problem):
        raise ProblemError(f"{found.target} must be a hhtbench.Problem or return one; got {_kind_of(made)}.")
    if parameters or not isinstance(made.system, System) or np.size(made.events):  # events refer to their systems
        return made
    system = _known(str(found), made.system)
    return made if system is made.system else replace(made, system=system)


def _known(spec: str, made: System) -> System:
    """Return the System stored for ``spec`` if it equals ``made``; else store and return ``made``."""
    with _lock:
        before = _systems.pop(spec, made)
        _systems[spec] = system = before if _equal(before, made) else made
        if len(_systems) > MAX_SYSTEMS:
            _systems.pop(next(iter(_systems)))
    return system


def _equal(one: System, other: System) -> bool:
    """True if two systems have the same class and bitwise equal values."""
    try:
        forms: list[Any] = [jax.tree.structure(x) for x in (one, other)]
        return (
            repr(forms[0]) == repr(forms[1])
            and forms[0] == forms[1]
            and all(x is y or _same_array(x, y) for x, y in zip(*map(jax.tree.leaves, (one, other)), strict=True))
        )
    except (TypeError, ValueError):  # fields that do not compare
        return False


def _same_array(x: Any, y: Any) -> bool:
    arrays = isinstance(x, jax.Array) and isinstance(y, jax.Array) and (x.dtype, x.shape) == (y.dtype, y.shape)
    return arrays and np.asarray(x).tobytes() == np.asarray(y).tobytes()


@contextmanager
def holding(problems: Mapping[str, Problem]) -> Iterator[None]:
    """Context manager in which these names mean these problems, before registered ones, in this process only."""
    token = _HELD.set(problems)
    try:
        yield
    finally:
        _HELD.reset(token)


def is_held(name: str) -> bool:
    """True if ``name`` is the name of a problem given to :func:`holding`."""
    return name in _HELD.get()


def thumbnail_of(name: str) -> Path | None:
    """Return the PNG file with the drawing of a registered problem at its default parameters; None if there is none."""
    if name not in list_problems():
        return None
    folder = own_folder(plugins.find("problem", name))
    file = None if folder is None else folder / THUMBNAILS / f"{name}.png"
    return file if file is not None and file.is_file() else None


def load_solver(spec: str | Solver, **options: Any) -> Solver:
    """Load the solver of a spec, ``hht(alpha=-0.1)``; return a solver as it is.  Errors as in :func:`load_problem`."""
    if not isinstance(spec, str):
        if not _is_solver(spec):
            raise TypeError(
                f"a solver must be a spec, 'hht(alpha=-0.1)', or have accepts() and solve(); got {_kind_of(spec)}."
            )
        _refuse_arguments("the solver", options)
        return spec
    found = parse_spec(spec)
    made = _make("solver", found, options)
    if not _is_solver(made):
        raise ProblemError(
            f"{found.target} must be a solver with accepts() and solve(), or return one; got {_kind_of(made)}."
        )
    return made


def load_verification(name: str) -> Verification:
    """Load the verification registered as ``name``, a function ``verify(progress, jobs) -> Evidence``."""
    found = parse_spec(name)
    if found.path is not None or found.arguments:
        raise ProblemError(f"a verification is named without file and arguments; got {name}.")
    verify = plugins.load("verification", found.name)
    if not callable(verify):
        raise ProblemError(f"the verification {name} must be a function; got {_kind_of(verify)}.")
    return verify


def _make(kind: str, spec: Spec, further: Mapping[str, Any]) -> Any:
    """Load the target of a spec; if it is a function or class, call it with the arguments."""
    twice = sorted(set(spec.arguments) & set(further))
    if twice:
        raise ProblemError(f"{', '.join(twice)} is given in the spec {spec} and again as a keyword; give it once.")
    arguments = {**spec.arguments, **further}
    target = plugins.load(kind, spec.name) if spec.path is None else _from_file(spec.path, spec.name)
    if isinstance(target, Problem) or _is_solver(target):
        _refuse_arguments(spec.target, arguments)
        return target
    if not callable(target):
        return target
    try:
        return target(**arguments)
    except TypeError:
        _check_arguments(spec.target, target, arguments)
        raise


def _from_file(path: str, name: str) -> Any:
    from hhtbench.catalogue.filespec import load_attribute  # it knows worker processes, which registered names do not need

    return load_attribute(path, name)


def _check_arguments(name: str, factory: Callable[..., Any], arguments: Mapping[str, Any]) -> None:
    """Raise a ProblemError if ``arguments`` do not fit the signature, and not because of a TypeError inside the factory."""
    try:
        signature = inspect.signature(factory)
    except (TypeError, ValueError):
        return  # a compiled callable without a signature: calling it will tell
    known = [p for p in signature.parameters.values() if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    try:
        signature.bind(**arguments)
    except TypeError as error:
        shown = ", ".join(str(p.replace(annotation=p.empty)) for p in known)
        wrong = [key for key in arguments if key not in {p.name for p in known}]
        hint = did_you_mean(wrong[0], [p.name for p in known]) if wrong else ""
        raise ProblemError(f"{name}: {error}.{hint} Known parameters: {shown or 'none'}.") from error


def _refuse_arguments(name: str, arguments: Mapping[str, Any]) -> None:
    if arguments:
        raise ProblemError(f"{name} is no function and takes no parameters; got {', '.join(sorted(arguments))}.")


def _is_solver(value: Any) -> bool:
    return (
        not isinstance(value, type) and callable(getattr(value, "accepts", None)) and callable(getattr(value, "solve", None))
    )


def _kind_of(value: Any) -> str:
    return f"the class {value.__name__}" if isinstance(value, type) else f"{type(value).__name__}"


def with_events(solver: Solver, problem: Problem, events: Any = None) -> Solver:
    """Return the solver with ``events``, if None those of the problem, and with the samples of its inputs.

    They are the solver's own events or those found between its steps; without any it is the solver itself.
    """
    events = problem.events if events is None else events
    listed = [*events] if isinstance(events, (list, tuple)) else [events]
    if not listed and not problem.samples:
        return solver
    layout = declared(problem.system, "layout")
    if layout is not None:
        from hhtbench.protocol.extension import extended_events

        listed = [*extended_events(listed, layout), *problem.samples]
    from hhtbench.protocol.wrong_use import require_events

    require_events(listed)
    between = bool(problem.samples) or any(getattr(event, "between_steps", False) for event in listed)
    own: Any = None if between else getattr(solver, "with_events", None)
    own = own or partial(plugins.load("name", "with_events"), solver)
    made: Solver = own(listed)
    return made
