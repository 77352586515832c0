"""XLA's code for comparisons, made in half of the time: the same operations, which need not be fast."""

from typing import Any

QUICKLY = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}


def compiled(jitted: Any, *arguments: Any) -> Any:
    """The code of ``jax.jit(function)`` for such ``arguments``."""
    return jitted.lower(*arguments).compile(compiler_options=QUICKLY)
