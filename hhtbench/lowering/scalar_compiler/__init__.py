"""The native route: small functions as straight-line machine code.  LOWERING.md, beside this package, explains it."""

from hhtbench.lowering.scalar_compiler.at_rows import at_rows
from hhtbench.lowering.scalar_compiler.compiler import (
    Native,
    count_operations,
    native,
    native_call,
    pattern_along,
    places_of,
)
from hhtbench.lowering.scalar_compiler.store import NotNative

__all__ = [
    "Native",
    "NotNative",
    "at_rows",
    "count_operations",
    "native",
    "native_call",
    "pattern_along",
    "places_of",
]
