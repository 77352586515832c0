"""Loop rerolling: the scalar graph of many equal bodies as loops over equal expressions.

Numbers that are needed more than once are kept in memory, every other node is part of the expression that needs it.
Expressions of one form of which none waits for another are the turns of one loop, which finds its numbers by index.
Every node is computed once, as in straight lines and with the same values; what shrinks is the code.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

import numpy as np

from hhtbench.lowering.scalar_compiler.dependencies import IS_CALL, generations, needs, operands
from hhtbench.lowering.scalar_compiler.emit import MEMORY
from hhtbench.lowering.scalar_compiler.graph import Graph
from hhtbench.lowering.scalar_compiler.store import ARITY, BOOLEAN, CALLS, CODES, FEW, LEAVES, NAMES, Ids, TooLarge

CONSTANT, KEPT, TRUTH = ("constant",), ("kept",), ("truth",)  # leaves beside parameters and arguments; truths are 1 or 0
FORMS = 2**19  # that are told apart by as many bits; each is an operation of the code at least
Form = tuple[Any, ...]  # of a leaf: where it is found; else operation, its parameters and the numbers of its operands' forms


@dataclass(frozen=True, eq=False)
class Loop:
    """Expressions of one form, one for each turn."""

    form: int
    sources: Ids  #: (turns, leaves) places of the leaves in memory, of constants their bits
    targets: Ids  #: (turns,) place of the value in the result or among the numbers kept
    last: bool  #: the value is part of the result
    truth: bool  #: it is a boolean


class Rerolled:
    """The ``loops`` that compute ``outputs`` of ``graph``, in order, and how many numbers they keep: ``room``.

    ``counts``: how often each node is needed, :func:`~.dependencies.needed`.  ``limit``: operations of all loops' turns.
    """

    def __init__(self, graph: Graph, outputs: Ids, counts: Ids, limit: int) -> None:
        self.graph, self.room = graph, 0
        self.forms: list[Form] = []
        self._numbers: dict[Form, int] = {}
        self._lengths: list[int] = []  #: length of each form, in operations
        self._kept = self._number(KEPT), self._number(TRUTH)
        self._code, self._operands = graph.column("code"), [graph.column(name) for name in "xyz"]
        live, size = np.flatnonzero(counts), len(graph.code)
        self._form = np.zeros(size, dtype=np.int32)  #: form of each node; of a stored node that of its memory index
        self._level = np.zeros(size, dtype=np.int32)  #: for how many loops they wait
        self._places = np.zeros(size, dtype=np.int64)  #: memory index of each node that is stored
        single = np.isin(NAMES, LEAVES)
        shared = live[(counts[live] > 1) & ~single[self._code[live]] | IS_CALL[self._code[live]]]
        shared = shared[self._code[shared] != CODES["entry"]]
        keeps, own = np.zeros(size, dtype=bool), np.zeros(size, dtype=np.int32)
        keeps[shared] = True
        for nodes in generations(graph, live):
            forms = own[nodes] = self._visited(nodes)
            of_truth = np.where(BOOLEAN[self._code[nodes]], self._kept[1], self._kept[0])
            self._form[nodes] = np.where(keeps[nodes], of_truth, forms)
            self._level[nodes] += keeps[nodes]
        varying = np.flatnonzero(self._code[outputs] != CODES["constant"])
        last = outputs[varying]
        kept = self._grouped(self._level[shared], own[shared], shared, shared, last=False)
        results = self._grouped(self._level[last] + 1, self._form[last], last, varying, last=True)
        groups = sorted((kept | results).items(), key=itemgetter(0))
        length = sum(self._lengths[form] for (_, _, form), _ in groups)
        if length > limit:
            raise TooLarge(f"{length} scalar operations, more than {limit}")
        self.loops = [self._loop(*key, *group) for key, group in groups]

    def _visited(self, nodes: Ids) -> Ids:
        """The forms of the expressions of ``nodes``, one generation; sets the levels of their operands."""
        found, who = operands(self.graph, nodes)
        np.maximum.at(self._level, nodes[who], self._level[found])
        first = which = np.arange(nodes.size)
        if nodes.size > FEW:
            _, first, which = np.unique(self._keys(nodes), return_index=True, return_inverse=True)
        return np.array([self._number(self._described(node)) for node in nodes[first].tolist()])[which]

    def _keys(self, nodes: Ids) -> np.ndarray:
        """Integer keys, equal for expressions of one form."""
        code = self._code[nodes]
        keys = code.astype(np.uint64)
        for i, operand in enumerate(self._operands):
            part = np.where(ARITY[code] > i, self._form[operand[nodes] * (ARITY[code] > i)], 0)
            if i == 0:  # an operand that is an argument is described by its number
                part = np.where(code == CODES["argument"], operand[nodes], part)
            keys = keys * FORMS + part.astype(np.uint64)
        calls = np.flatnonzero(IS_CALL[code])
        keys[calls] += calls.astype(np.uint64)  # they are described one by one
        return keys

    def _described(self, node: int) -> Form:
        """Form of the expression at a node."""
        graph, name = self.graph, NAMES[self._code[node]]
        if name == "entry":
            return KEPT
        if name in ("constant", "parameter", "argument"):
            return (name, graph.x[node]) if name == "argument" else (name,)
        sizes = (graph.x[node], graph.y[node]) if name in CALLS else ()
        return (name, sizes, *(int(self._form[operand]) for operand in needs(graph, node)))

    def _grouped(
        self, level: Ids, form: Ids, nodes: Ids, targets: Ids, *, last: bool
    ) -> dict[tuple[int, bool, int], tuple[Ids, Ids]]:
        """``nodes`` and ``targets`` by (level, last, form)."""
        order = np.lexsort((form, level))
        ends = np.flatnonzero(np.diff(level[order]) | np.diff(form[order])) + 1
        groups = (part for part in np.split(order, ends) if part.size)
        return {(int(level[part[0]]), last, int(form[part[0]])): (nodes[part], targets[part]) for part in groups}

    def _number(self, form: Form) -> int:
        found = self._numbers.setdefault(form, len(self.forms))
        if found == len(self.forms):
            self.forms.append(form)
            operations = len(form) - 2 if form[0] in CALLS else 1  # a call's are its stores
            self._lengths.append(0 if self.is_leaf(found) else operations + sum(self._lengths[part] for part in form[2:]))
        if found == FORMS:
            raise TooLarge(f"{FORMS} different expressions")
        return found

    def is_leaf(self, form: int) -> bool:
        """True if the form is read from memory, or a constant."""
        return self.forms[form][0] in (*MEMORY, *CONSTANT, *KEPT, *TRUTH)

    def parts(self, form: int) -> Iterator[int]:
        """The forms of an expression's leaves and operations, operands first."""
        stack = [(form, False)]
        while stack:
            part, ready = stack.pop()
            if ready or self.is_leaf(part):
                yield part
            else:
                stack.append((part, True))
                stack.extend((operand, False) for operand in reversed(self.forms[part][2:]))

    def leaves(self, form: int) -> list[int]:
        """The forms of an expression's leaves, in order."""
        return [part for part in self.parts(form) if self.is_leaf(part)]

    def width(self, form: int) -> int:
        """Numbers stored per turn; those of a call include its arguments."""
        operation, parameters, *operands = self.forms[form]
        return len(operands) + (parameters[1] if operation == "foreign" else 0) if operation in CALLS else 1

    def _loop(self, level: int, last: bool, form: int, nodes: Ids, targets: Ids) -> Loop:
        """Turns in the order of their sources: places then rise evenly."""
        columns = list(self._sources(form, nodes))
        order = np.lexsort(columns[::-1]) if columns else np.arange(nodes.size)
        truth = not last and bool(BOOLEAN[self._code[nodes[0]]])
        sources = np.stack(columns, axis=1)[order] if columns else np.zeros((nodes.size, 0), dtype=np.int64)
        return Loop(form, sources, targets[order] if last else self._settled(form, nodes[order]), last, truth)

    def _sources(self, form: int, nodes: Ids) -> Iterator[Ids]:
        """The places of the leaves of expressions, leaf by leaf."""
        stack = [(form, nodes)]
        while stack:
            part, nodes = stack.pop()
            if self.is_leaf(part):
                yield self._found(self.forms[part], nodes)
                continue
            columns: Any = (operand[nodes] for operand in self._operands)
            if self.forms[part][0] in CALLS:
                columns = np.stack([self.graph.operands[node] for node in nodes.tolist()], axis=1)
            stack += list(zip(self.forms[part][2:], columns, strict=False))[::-1]

    def _found(self, where: Form, nodes: Ids) -> Ids:
        """The places of numbers in memory, or the bits of constants."""
        x, y, _ = self._operands
        if where == CONSTANT:
            return self.graph.column("values")[x[nodes]].view(np.int64)
        if where not in (KEPT, TRUTH):
            return (x if where == ("parameter",) else y)[nodes].astype(np.int64)
        entry = self._code[nodes] == CODES["entry"]
        return np.where(entry, self._places[x[nodes] * entry] + y[nodes], self._places[nodes])

    def _settled(self, form: int, nodes: Ids) -> Ids:
        """Room for the values of ``nodes``."""
        operation, _, *parts = self.forms[form]
        targets = self.room + self.width(form) * np.arange(nodes.size)
        self.room += self.width(form) * nodes.size
        self._places[nodes] = targets + (len(parts) if operation == "foreign" else 0)
        return targets
