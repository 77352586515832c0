"""What functions return, by one piece of XLA's code: called as they are, JAX compiles operation by operation."""

from collections.abc import Callable, Sequence
from typing import Any

import jax


def values(functions: Sequence[Callable[..., Any]], *arguments: Any) -> Sequence[Any]:
    """What each of ``functions`` returns."""
    return jax.jit(lambda *given: [function(*given) for function in functions])(*arguments)
