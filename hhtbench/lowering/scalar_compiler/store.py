"""Storage of the scalar graph's nodes in arrays, each node once; made singly or a whole array at a time.

A large system has millions.  A dictionary finds nodes made singly; after the first array a hash table with open addressing
finds all of them.
"""

from __future__ import annotations

import copy
from array import array
from typing import Any, Self

import numpy as np

from hhtbench.lowering.scalar_compiler.operations import COMPARISONS, FUNCTIONS, INSTRUCTIONS, LOGIC

Ids = np.ndarray  #: whole numbers: nodes

ZERO, ONE, MINUS_ONE, FALSE, TRUE = range(5)  # the first nodes of every graph

LEAVES = "constant", "parameter", "argument", "true", "false"
CALLS = "solve", "banded", "foreign"  # operations with many operands and results
NAMES = (*LEAVES, "entry", *CALLS, *INSTRUCTIONS, *FUNCTIONS)
CODES = {name: code for code, name in enumerate(NAMES)}
TWO = "atan2", "max", "min", "pow"  # functions of two numbers; the others take one
ARITIES = [
    INSTRUCTIONS[name].count("{}")
    if name in INSTRUCTIONS
    else 1 + (name in TWO)
    if name in FUNCTIONS
    else int(name == "entry")
    for name in NAMES
]  #: by code, how many operands are nodes, but for those of calls
ARITY = np.array(ARITIES, dtype=np.uint8)
BOOLEAN = np.isin(NAMES, (*COMPARISONS, *LOGIC, "true", "false", "select_bool"))  #: by code
FEW = 32  # nodes up to which they are made one by one: that is faster
IN_ARRAYS = 20  # nodes that may be made for each that may be made alone: in arrays they take a twentieth of its time
WORD = 2**64 - 1


class NotNative(Exception):
    """The function cannot be machine code, or that would not pay; XLA compiles it instead."""

    def __init__(self, reason: str) -> None:
        self.reason = reason  #: in words, with the user's source line where it is known
        super().__init__(reason)


class TooLarge(NotNative):
    """More scalar operations than machine code pays for."""


class Store:
    """Nodes as parallel arrays: the operation ``NAMES[code[i]]`` on the nodes ``x[i]``, ``y[i]`` and ``z[i]``.

    Of leaves these say where the number is: a constant among ``values``, a parameter in its vector, an argument by its
    number and the place in it; of an entry the call and the place in its result; of a call its two sizes.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit  #: nodes that may be made alone, live or not
        self.code, self.depth = array("B"), array("i")  #: ``depth``: larger than that of all operands
        self.x, self.y, self.z = array("i"), array("i"), array("i")
        self.values = array("d")  #: values of constants
        self.operands: dict[int, Ids] = {}  #: operands of calls
        self._known: dict[tuple[Any, ...], int] = {}
        self._table = np.zeros(0, dtype=np.int32)  #: nodes by their hash, -1 for none
        self._entered = 0  #: nodes that are in the table

    def operation(self, node: int) -> str:
        """Name of a node's operation."""
        return NAMES[self.code[node]]

    def column(self, name: str) -> np.ndarray:
        """One of the arrays as a NumPy view; no node can be made while it is in use."""
        own: array[Any] = getattr(self, name)
        return np.frombuffer(own, dtype=own.typecode)

    def close(self) -> None:
        """Free the tables that find nodes; no more will be made."""
        self._known, self._table, self.limit = {}, np.zeros(0, dtype=np.int32), 0

    def changed(self, nodes: Ids, operation: str, x: int, y: Ids) -> Self:
        """A copy in which ``nodes`` are leaves."""
        other = copy.copy(self)
        other.code, other.x, other.y = self.code[:], self.x[:], self.y[:]
        for name, value in (("code", CODES[operation]), ("x", x), ("y", y)):
            other.column(name)[nodes] = value
        return other

    def node(self, operation: str, x: int = -1, y: int = -1, z: int = -1) -> int:
        """The node of this operation on these operands, as they are."""
        key = (operation, x, y, z)
        found = self._known.get(key)
        if found is None:
            code = CODES[operation]
            found = self._find(code, x, y, z) if self._entered else None
            self._known[key] = found = self._append(code, x, y, z) if found is None else found
        return found

    def call(self, operation: str, sizes: tuple[int, int], operands: Ids) -> int:
        """The node of an operation with many results."""
        operands = operands.astype(np.int64)
        key = (operation, sizes, operands.tobytes())
        found = self._known.get(key)
        if found is None:
            self._known[key] = found = self._append(CODES[operation], *sizes, len(self.code))  # which is no other's z
            self.operands[found] = operands
            self.depth[found] = 1 + int(self.column("depth")[operands].max(initial=0))
        return found

    def each(self, operation: str, *operands: Ids) -> Ids:
        """:meth:`node` entry by entry of arrays of one shape."""
        flat, shape = [x.ravel() for x in operands], operands[0].shape
        if flat[0].size > FEW:
            return self._nodes(operation, *flat).reshape(shape)
        entries = zip(*(x.tolist() for x in flat), strict=True)
        return np.array([self.node(operation, *entry) for entry in entries], dtype=np.int32).reshape(shape)

    def entries(self, call: int, places: Ids) -> Ids:
        """Nodes of the entries of a call's result at ``places``."""
        return self.each("entry", np.full(places.shape, call), places)

    def _append(self, code: int, x: int, y: int, z: int) -> int:
        if len(self._known) >= self.limit:
            raise TooLarge(f"more than {self.limit} scalar operations")
        depth, arity = self.depth, ARITIES[code]
        deep = depth[x] + 1 if arity else 0
        if arity > 1:
            deep = max(deep, depth[y] + 1, depth[z] + 1 if arity > 2 else 0)
        for column, value in ((self.code, code), (self.x, x), (self.y, y), (self.z, z), (depth, deep)):
            column.append(value)
        return len(self.code) - 1

    def _nodes(self, operation: str, *operands: Ids) -> Ids:
        """:meth:`node` entry by entry of arrays (k,) that are not short."""
        count, first = operands[0].size, len(self.code)
        if first + count > IN_ARRAYS * self.limit:
            raise TooLarge(f"more than {IN_ARRAYS * self.limit} scalar operations")
        self._enter(self._entered, first)  # those made alone since
        self.code.frombytes(bytes([CODES[operation]]) * count)
        for name, values in zip("xyz", (*operands, None, None)[:3], strict=True):
            part = np.full(count, -1) if values is None else values
            getattr(self, name).frombytes(part.astype(np.int32).tobytes())
        found, places = self._enter(first, first + count)
        made = np.flatnonzero(found == np.arange(first, first + count))
        last = first + made.size
        if made.size < count:  # the others leave
            number = np.empty(count, dtype=np.int64)
            number[made] = np.arange(first, last)
            found[found >= first] = number[found[found >= first] - first]
            self._table[places[made]] = np.arange(first, last)
            for name in ("code", "x", "y", "z"):
                column = self.column(name)
                column[first:last] = column[first + made]
                del column
                del getattr(self, name)[last:]
        before = [self.column("depth")[x[made]] for x in operands[: ARITIES[CODES[operation]]]]
        depth = np.max(before, axis=0) + 1 if before else np.zeros(made.size)
        self.depth.frombytes(depth.astype(np.int32).tobytes())
        self._entered = last
        return found.astype(np.int32)  # half the memory of what lives during a lowering

    def _enter(self, first: int, last: int) -> tuple[Ids, Ids]:
        """The equals of the nodes from ``first`` to before ``last``, which come into the table, and their places there."""
        if 2 * last > self._table.size:
            self._table = np.full(1 << (2 * last).bit_length(), -1, dtype=np.int32)
            self._enter(0, first)
        code, x, y, z = (self.column(name) for name in ("code", "x", "y", "z"))
        nodes, last_place = np.arange(first, last), self._table.size - 1
        words = (column[first:last].astype(np.int64).view(np.uint64) for column in (code, x, y, z))
        places = (_hashed(*words) & last_place).astype(np.int64)
        found, left = nodes.copy(), np.arange(nodes.size)
        while left.size:
            own, at = nodes[left], places[left]
            empty = self._table[at] < 0
            self._table[at[empty]] = own[empty]  # where several fit, the last one
            there = self._table[at]
            same = (x[there] == x[own]) & (y[there] == y[own]) & (code[there] == code[own]) & (z[there] == z[own])
            found[left[same]] = there[same]
            left = left[~same]
            places[left] = (places[left] + 1) & last_place
        self._entered = max(self._entered, last)
        return found, places

    def _find(self, code: int, x: int, y: int, z: int) -> int | None:
        """The equal node in the hash table, or None."""
        table, last_place = self._table, self._table.size - 1
        place = _hashed(*(word & WORD for word in (code, x, y, z))) & last_place
        while (there := int(table[place])) >= 0:
            if (self.x[there], self.y[there], self.z[there], self.code[there]) == (x, y, z, code):
                return there
            place = (place + 1) & last_place
        return None


def _hashed(code: Any, x: Any, y: Any, z: Any) -> Any:
    """64-bit hash of words, or arrays of words."""
    mixed = (x * 0x9E3779B97F4A7C15 + y * 0xC2B2AE3D27D4EB4F + z * 0x165667B19E3779F9 + code * 0xD6E8FEB86659FD93) & WORD
    mixed = ((mixed ^ (mixed >> 32)) * 0xD6E8FEB86659FD93) & WORD
    return mixed ^ (mixed >> 32)
