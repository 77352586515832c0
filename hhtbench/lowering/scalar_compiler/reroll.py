"""Loop rerolling: the scalar graph of many equal bodies as loops over equal expressions.

Numbers that are needed more than once are kept in memory, every other node is part of the expression that needs it.
Expressions of one form of which none waits for another are the turns of one loop, which finds its numbers by index.
Every node is computed once, as in straight lines and with the same values; what shrinks is the code.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.lowering.scalar_compiler.emit import CALLS, MEMORY
from hhtbench.lowering.scalar_compiler.graph import Graph, Ids

CONSTANT, KEPT, TRUTH = ("constant",), ("kept",), ("truth",)  # leaves beside parameters and arguments; truths are 1 or 0
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

    ``counts``: how often each node is needed, :func:`~.emit.needed`.
    """

    def __init__(self, graph: Graph, outputs: list[int], counts: list[int]) -> None:
        self.graph, self.room = graph, 0
        self.forms: list[Form] = []
        self._numbers: dict[Form, int] = {}
        self._kept = self._number(KEPT), self._number(TRUTH)
        self._seen: dict[int, tuple[int, list[int], int]] = {}  #: of a node: form, leaves, how many loops it waits for
        self._places = np.zeros(len(graph.operation), dtype=np.int64)  #: of nodes that are kept
        self._groups: dict[tuple[int, bool, int], list[tuple[int, list[int]]]] = {}
        self._entries: dict[int, list[int]] = {}  #: nodes that are entries of a call's result
        for node, count in enumerate(counts):
            if count:
                self._seen[node] = self._visited(node, count)
        for place, node in enumerate(outputs):
            if node not in graph.number:
                form, leaves, level = self._seen[node]
                self._groups.setdefault((level + 1, True, form), []).append((place, leaves))
        self.loops = [self._loop(*key) for key in sorted(self._groups)]

    def _visited(self, node: int, count: int) -> tuple[int, list[int], int]:
        graph, operation, operands = self.graph, self.graph.operation[node], self.graph.operands[node]
        if operation in MEMORY or operation == "constant":
            if operation == "entry":
                self._entries.setdefault(operands[0], []).append(node)
                return self._kept[0], [node], self._seen[operands[0]][2]
            return self._number((operation, *operands[:-1])), [operands[-1]], 0
        parameters, parts = (operands[:2], operands[2:]) if operation in CALLS else ((), operands)
        forms, leaves, level = list[int](), list[int](), 0
        for part in parts:
            form, more, before = self._seen[part]
            forms.append(form)
            leaves += more
            level = max(level, before)
        number = self._number((operation, parameters, *forms))
        if operation not in CALLS and count == 1:
            return number, leaves, level
        self._groups.setdefault((level + 1, False, number), []).append((node, leaves))
        return self._kept[graph.is_bool(node)], [node], level + 1

    def _number(self, form: Form) -> int:
        found = self._numbers.setdefault(form, len(self.forms))
        if found == len(self.forms):
            self.forms.append(form)
        return found

    def is_leaf(self, form: int) -> bool:
        """Whether it is read from memory, or a constant."""
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
        """Numbers kept of one turn: a call's arguments lie in a row with its result."""
        operation, parameters, *operands = self.forms[form]
        return len(operands) + (parameters[1] if operation == "foreign" else 0) if operation in CALLS else 1

    def _loop(self, level: int, last: bool, form: int) -> Loop:
        """Turns in the order of their sources: places then rise evenly."""
        members = self._groups[level, last, form]
        targets = np.array([node for node, _ in members])
        sources = np.array([leaves for _, leaves in members], dtype=np.int64).reshape(len(members), -1)
        kept = np.isin(self.leaves(form), self._kept)
        sources[:, kept] = self._places[sources[:, kept]]
        order = np.lexsort(sources.T[::-1]) if sources.size else np.arange(len(members))
        truth = not last and self.graph.is_bool(members[0][0])
        return Loop(form, sources[order], targets[order] if last else self._settled(form, targets[order]), last, truth)

    def _settled(self, form: int, nodes: Ids) -> Ids:
        """Room for the values of ``nodes``."""
        operation, _, *operands = self.forms[form]
        targets = self.room + self.width(form) * np.arange(nodes.size)
        self.room += self.width(form) * nodes.size
        self._places[nodes] = targets
        if operation in CALLS:
            first = len(operands) if operation == "foreign" else 0
            for node, target in zip(nodes.tolist(), targets.tolist(), strict=True):
                for entry in self._entries.get(node, ()):
                    self._places[entry] = target + first + self.graph.operands[entry][1]
        return targets
