"""Campaigns on problems given as objects: through the file that holds one, else in this process."""

from __future__ import annotations

import gc
import re
import sys
import warnings
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from hhtbench.campaign.execute import Limits, WorkerPool
from hhtbench.campaign.machine import machine_facts
from hhtbench.campaign.worker import Bench
from hhtbench.catalogue.filespec import refuse_nested
from hhtbench.catalogue.specs import canonical, parse_spec
from hhtbench.protocol.arguments import shown
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import IMPORTED
from hhtbench.runtime.processes import Inline

MTIME_ROUNDING = 2.0  # [s]; some file systems store times of change no finer


@dataclass(frozen=True)
class Named:
    """Specs of problems, and the objects that some of them stand for in this process only."""

    specs: tuple[str, ...]
    held: dict[str, Problem] = field(default_factory=dict)  #: for :func:`hhtbench.catalogue.registry.holding`
    note: str = ""  #: what follows for the user


def named(problems: Iterable[Any], **others: Any) -> Named:
    """Return the specs of ``problems``, each a spec or a Problem; warn if objects must be solved in this process.

    Raises
    ------
    TypeError
        One is neither.
    ProblemError
        Two objects have one name, or one of ``others``, which need a problem's file, is given and there is no file.
    """
    refuse_nested()
    specs: list[str] = []
    held: dict[str, Problem] = {}
    for problem in problems:
        if not isinstance(problem, (str, Problem)):
            raise TypeError(f"a problem must be a spec, as 'my.py:problem', or a hhtbench.Problem; got {shown(problem)}.")
        spec = problem if isinstance(problem, str) else spec_in_file(problem) or re.sub(r"\W+", "_", problem.name) or "own"
        specs.append(spec)
        if isinstance(problem, Problem) and ".py:" not in spec and held.setdefault(spec, problem) is not problem:
            raise ProblemError(f"two different problems are named {problem.name}; give them different names.")
    if not held:
        return Named(tuple(specs))
    if refused := [name for name, value in others.items() if value is not None]:
        raise ProblemError(
            f"{refused[0]} needs a problem that a file names, and no imported file holds the Problem {', '.join(held)}; "
            f"give it as 'my.py:problem', or leave out {refused[0]}."
        )
    note = (
        f"No imported file holds the Problem {', '.join(held)}: all was solved in one process, where nothing ends a solve "
    )
    note += "that hangs, and no rows are kept; give it as 'my.py:problem' for worker processes."
    warnings.warn(note, stacklevel=3)
    return Named(tuple(specs), held, note)


def spec_in_file(problem: Problem) -> str | None:
    """Return ``my.py:problem`` if an imported file has this very object as a global; else None.

    The main module is excluded, since executing it again may do anything, and so is a file changed since its import.
    """
    for name, module in list(sys.modules.items()):
        known = getattr(module, "__dict__", {})
        places = [key for key, value in list(known.items()) if value is problem]
        file = Path(known.get("__file__") or "")
        if not places or name == "__main__" or "." in name or file.suffix != ".py" or not file.is_file():
            continue
        if getattr(known.get("__spec__"), "_initializing", False) or file.stat().st_mtime > IMPORTED - MTIME_ROUNDING:
            continue
        near = file.relative_to(Path.cwd()) if file.is_relative_to(Path.cwd()) else file
        with suppress(ProblemError):  # a name that no spec can have
            if parse_spec(spec := f"{near}:{places[0]}").path == str(near):
                return canonical(spec)
    return None


class ThisProcess(WorkerPool):
    """Executor that runs each task at once in this process, for problems that no other process can load."""

    def __init__(self) -> None:
        super().__init__(Limits(jobs=1))
        self._bench = Bench(lambda phase: None)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run the task now and return a finished future."""
        (task,) = args
        done = Inline().submit(self._bench.do, asdict(task))
        gc.unfreeze()  # what a warm-up froze for the rest of a worker's life
        return Inline().submit(lambda: {"environment": machine_facts(), **done.result()})
