"""Set JAX to 64-bit numbers in every process that imports hhtbench, whichever of the two is imported first.

JAX's import takes half a second of processor time, which ``import hhtbench`` and ``hhtbench list`` do not need.  Hence a
post-import hook, which also covers a user's own ``import jax.numpy``.  JAX's environment variable would be simpler, but
the user's child processes would inherit it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

BEGAN = time.time()  #: when hhtbench was imported [s]

SETTINGS = {
    "jax_enable_x64": True,
    # Every call waits for its result; handing it to a thread of its own costs 10 us, and far more on a busy machine.
    "jax_cpu_enable_async_dispatch": False,  # without effect where JAX has computed before
}


def settle_jax() -> None:
    """Apply ``SETTINGS`` now if JAX is imported, else as soon as it is."""
    if "jax" in sys.modules:
        _apply(import_module("jax"))  # waits where another thread is importing it
    else:
        sys.meta_path.insert(0, _Hook())


def _apply(jax: ModuleType) -> None:
    for name, value in SETTINGS.items():
        jax.config.update(name, value)


class _Hook(MetaPathFinder):
    """Import hook that applies the settings right after JAX has been executed; finding JAX is left to the other finders."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        if name != "jax":
            return None
        behind = sys.meta_path[sys.meta_path.index(self) + 1 :]
        spec = next(filter(None, (finder.find_spec(name, path, target) for finder in behind)), None)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_apply(module: ModuleType) -> None:
                execute(module)
                _apply(module)
                sys.meta_path.remove(self)

            spec.loader.exec_module = execute_and_apply  # type: ignore[method-assign]  # replaced on this one loader
        return spec
