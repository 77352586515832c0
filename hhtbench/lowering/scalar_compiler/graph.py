"""The scalar graph: operations on single numbers, each stored once, with constants folded.

A node is a small integer.  Equal operations on equal nodes are one node (hash-consing), constants are folded, and
``x*0``, ``x+0``, ``x*1`` and the like vanish.  Folding ``0*x`` to 0 assumes that x is finite: a structural zero of a
Jacobian must not depend on values.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from functools import partial

import numpy as np

from hhtbench.lowering.scalar_compiler.arrays import entrywise
from hhtbench.lowering.scalar_compiler.operations import COMMUTATIVE, COMPARISONS, FOLDS, LOGIC
from hhtbench.lowering.scalar_compiler.store import BOOLEAN, CODES, FALSE, MINUS_ONE, ONE, TRUE, ZERO, Ids, Store

NEG, NOT, ABS = map(CODES.get, ("neg", "not", "abs"))


class Graph(Store):
    """The nodes, and the rules that simplify operations on them."""

    def __init__(self, limit: int) -> None:
        super().__init__(limit)
        self.number: dict[int, float] = {}  #: node -> value, of constants
        self._of_bits: dict[bytes, int] = {}  #: the nodes of constants
        for value in (0.0, 1.0, -1.0):
            self.constant(value)
        self.node("false")
        self.node("true")

    def constant(self, value: float) -> int:
        """Node of a number; -0.0 and 0.0 are two, every NaN is one."""
        value = float(value) if value == value else math.nan
        bits = struct.pack("<d", value)
        made = self._of_bits.get(bits)
        if made is None:
            made = self._of_bits[bits] = self.node("constant", len(self.values))
            self.values.append(value)
            self.number[made] = value
        return made

    def constants(self, values: np.ndarray) -> Ids:
        """Nodes of an array of numbers or booleans."""
        array = np.asarray(values)
        if array.dtype == bool:
            return np.where(array, TRUE, FALSE).astype(np.int32)
        bits, places = np.unique(array.astype(np.float64).view(np.int64), return_inverse=True)
        nodes = np.array([self.constant(value) for value in bits.view(np.float64).tolist()], dtype=np.int32)
        return nodes[places].reshape(array.shape)

    def neg(self, x: int) -> int:
        """-x."""
        if x in self.number:
            return self.constant(-self.number[x]) if self.number[x] else ZERO
        if self.code[x] == NEG:
            return self.x[x]
        return self.node("neg", x)

    def add(self, x: int, y: int) -> int:
        """x + y."""
        number = self.number
        if number.get(x) == 0.0:
            return y
        if number.get(y) == 0.0:
            return x
        if x in number and y in number:
            return self.constant(number[x] + number[y])
        if self.code[y] == NEG:
            return self.sub(x, self.x[y])
        if self.code[x] == NEG:
            return self.sub(y, self.x[x])
        return self.node("add", x, y) if x < y else self.node("add", y, x)

    def sub(self, x: int, y: int) -> int:
        """x - y."""
        number = self.number
        if x in number and y in number:
            return self.constant(number[x] - number[y])
        if number.get(x) == 0.0:
            return self.neg(y)
        if number.get(y) == 0.0:
            return x
        if self.code[y] == NEG:
            return self.add(x, self.x[y])
        return self.node("sub", x, y)

    def mul(self, x: int, y: int) -> int:
        """x * y; signs are moved in front, so that products that differ only in sign share a node."""
        number = self.number
        if x > y:
            x, y = y, x
        if x in number and y in number:
            return self.constant(number[x] * number[y])
        for one, other in ((x, y), (y, x)):
            value = number.get(one)
            if value == 0.0:
                return ZERO
            if value == 1.0:
                return other
            if value == -1.0:
                return self.neg(other)
        negative = False
        if self.code[x] == NEG:
            x, negative = self.x[x], True
        if self.code[y] == NEG:
            y, negative = self.x[y], not negative
        if negative:
            return self.neg(self.mul(x, y))
        return self.node("mul", x, y)

    def div(self, x: int, y: int) -> int:
        """x / y; division by a power of two becomes an exact product."""
        number = self.number
        if x in number and y in number:
            return self.constant(FOLDS["div"](number[x], number[y]))
        if y in number:
            mantissa, exponent = math.frexp(number[y])
            if abs(mantissa) == 0.5 and abs(exponent) < 1000:
                return self.mul(x, self.constant(1.0 / number[y]))
        if number.get(x) == 0.0:
            return ZERO
        if self.code[x] == NEG:
            return self.neg(self.div(self.x[x], y))
        return self.node("div", x, y)

    def power(self, x: Ids, exponent: int) -> Ids:
        """x to an integer power by squaring, in XLA's order, entry by entry."""
        if exponent < 0:
            return self.elementwise("div", np.int64(ONE), self.power(x, -exponent))
        result = np.full(x.shape, ONE, dtype=np.int64)
        while exponent:
            if exponent & 1:
                result = self.elementwise("mul", result, x)
            exponent >>= 1
            if exponent:
                x = self.elementwise("mul", x, x)
        return result

    def select(self, predicate: int, yes: int, no: int) -> int:
        """``yes`` where the boolean ``predicate`` holds, else ``no``."""
        if predicate == TRUE or yes == no:
            return yes
        if predicate == FALSE:
            return no
        if self.code[predicate] == NOT:
            return self.select(self.x[predicate], no, yes)
        return self.node("select_bool" if BOOLEAN[self.code[yes]] else "select", predicate, yes, no)

    def logic(self, name: str, *truths: int) -> int:
        """``and``, ``or``, ``xor``, ``not`` of booleans."""
        if name == "not":
            x = truths[0]
            if x in (TRUE, FALSE):
                return TRUE + FALSE - x
            return self.x[x] if self.code[x] == NOT else self.node("not", x)
        x, y = sorted(truths)
        if x in (TRUE, FALSE):
            if name == "xor":
                return y if x == FALSE else self.logic("not", y)
            decides = (name == "or") == (x == TRUE)
            return x if decides else y
        return self.node(name, x, y)

    def apply(self, name: str, *operands: int) -> int:
        """Node of an elementwise operation by its name."""
        special = _SPECIAL.get(name)
        if special is not None:
            return special(self, *operands)
        return self.logic(name, *operands) if name in LOGIC else self.plain(name, *operands)

    def plain(self, name: str, *operands: int) -> int:
        """Node of an operation without rules except folding of constants."""
        number = self.number
        if name in FOLDS and all(x in number for x in operands):
            value = FOLDS[name](*(number[x] for x in operands))
            return (TRUE if value else FALSE) if name in COMPARISONS else self.constant(value)
        return self.node(name, *(sorted(operands) if name in COMMUTATIVE else operands))

    def elementwise(self, name: str, *operands: Ids | np.int64) -> Ids:
        """:meth:`apply` entry by entry."""
        arrays = np.broadcast_arrays(*operands)
        if name in ("mul", "add", "sub"):
            return _quick(self, name, *arrays)
        with np.errstate(all="ignore"):  # it tells of what is folded inside
            return entrywise(self, name, *map(np.ravel, arrays)).reshape(arrays[0].shape)


def _quick(graph: Graph, name: str, x: Ids, y: Ids) -> Ids:
    """Products and sums where most entries are structural zeros, as in derivatives."""
    if name == "mul":
        result = np.full(x.shape, ZERO, dtype=np.int32)
        left = (x != ZERO) & (y != ZERO)
    else:
        result = np.where(y == ZERO, x, y) if name == "add" else x.copy()
        left = (y != ZERO) & ((x != ZERO) | (name == "sub"))
    result[left] = entrywise(graph, name, x[left], y[left])
    return result


def _in_total_order(name: str, graph: Graph, x: int, y: int) -> int:
    """Comparison with NaN last; the two zeros count as equal."""
    x_is_nan, y_is_nan = graph.apply("ne", x, x), graph.apply("ne", y, y)
    first = graph.logic("not", x_is_nan) if name == "lt" else y_is_nan
    return graph.logic("or", graph.apply(name, x, y), graph.logic("and", y_is_nan, first))


def _pow(graph: Graph, x: int, y: int) -> int:
    return graph.mul(x, x) if graph.number.get(y) == 2.0 else graph.plain("pow", x, y)


def _abs(graph: Graph, x: int) -> int:
    return graph.plain("abs", graph.x[x] if graph.code[x] in (NEG, ABS) else x)


def _sign(graph: Graph, x: int) -> int:
    below = graph.select(graph.apply("lt", x, ZERO), MINUS_ONE, x)
    return graph.select(graph.apply("gt", x, ZERO), ONE, below)


_SPECIAL: dict[str, Callable[..., int]] = {
    "abs": _abs,
    "add": Graph.add,
    "add_any": Graph.add,
    "clamp": lambda graph, low, x, high: graph.apply("min", graph.apply("max", x, low), high),
    "div": Graph.div,
    "is_finite": lambda graph, x: graph.apply("lt", graph.apply("abs", x), graph.constant(math.inf)),
    "le_to": partial(_in_total_order, "le"),
    "logistic": lambda graph, x: graph.div(ONE, graph.add(ONE, graph.apply("exp", graph.neg(x)))),
    "lt_to": partial(_in_total_order, "lt"),
    "max": lambda graph, x, y: x if x == y else graph.plain("max", x, y),
    "min": lambda graph, x, y: x if x == y else graph.plain("min", x, y),
    "mul": Graph.mul,
    "neg": Graph.neg,
    "pow": _pow,
    "quotient": lambda graph, x, y: graph.apply("trunc", graph.div(x, y)),
    "rsqrt": lambda graph, x: graph.div(ONE, graph.apply("sqrt", x)),
    "same": lambda graph, x, y: graph.logic("not", graph.logic("xor", x, y)),
    "select": Graph.select,
    "sign": _sign,
    "square": lambda graph, x: graph.mul(x, x),
    "sub": Graph.sub,
}
