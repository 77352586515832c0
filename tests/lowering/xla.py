"""XLA's code for comparisons, made in half of the time: the same operations, which need not be fast."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax

QUICKLY = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}
quickly = partial(jax.jit, compiler_options=QUICKLY)


def compiled(jitted: Any, *arguments: Any) -> Any:
    """The code of ``jax.jit(function)`` for such ``arguments``."""
    return jitted.lower(*arguments).compile(compiler_options=QUICKLY)


def values(functions: Sequence[Callable[..., Any]], *arguments: Any) -> Sequence[Any]:
    """What each returns, by one piece of code: called as they are, JAX compiles operation by operation."""
    return compiled(jax.jit(lambda *given: [function(*given) for function in functions]), *arguments)(*arguments)
