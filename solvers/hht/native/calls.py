"""Calls of machine code by its address from compiled loops."""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped, unused-ignore]
from numba import types
from numba.extending import intrinsic


def _invoke(typingctx: Any, address: Any, pointers: Any) -> Any:
    """Call ``void f(double*, ...)`` at ``address`` with the addresses ``pointers`` of its arrays."""
    count = pointers.count

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        double = ir.IntType(8).as_pointer()
        function = builder.inttoptr(arguments[0], ir.FunctionType(ir.VoidType(), [double] * count).as_pointer())
        builder.call(function, [builder.inttoptr(builder.extract_value(arguments[1], i), double) for i in range(count)])
        return context.get_dummy_value()

    return types.void(types.int64, types.UniTuple(types.int64, count)), generate


invoke: Any = intrinsic(_invoke)  #: (address, pointers) -> None
