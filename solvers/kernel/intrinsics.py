"""Numba code generators behind :mod:`solvers.kernel.sections`; imported only where loops are compiled."""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped, unused-ignore]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array


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


def _view(typingctx: Any, array: Any, start: Any, count: Any) -> Any:
    """``array[start : start + count]`` without the bounds handling of Numba's slices."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = signature.args[0]
        whole, part = make_array(kind)(context, builder, arguments[0]), make_array(kind)(context, builder)
        size = context.get_constant(types.intp, 8)
        populate_array(
            part,
            data=builder.gep(whole.data, [arguments[1]]),
            shape=cgutils.pack_array(builder, [arguments[2]]),
            strides=cgutils.pack_array(builder, [size]),
            itemsize=size,
            meminfo=None,
        )
        return part._getvalue()

    return array(array, types.int64, types.int64), generate


view: Any = intrinsic(_view)  #: (array of 8-byte entries, start, count) -> a part of it
