"""The native route: small functions as straight-line machine code.  LOWERING.md, beside this package, explains it."""

from hhtbench.lowering.scalar_compiler.compiler import Native, native
from hhtbench.lowering.scalar_compiler.errors import NotNative

__all__ = ["Native", "NotNative", "native"]
