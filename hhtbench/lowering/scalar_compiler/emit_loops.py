"""Writes rerolled loops as LLVM assembly: one short loop after the other over the numbers kept."""

from __future__ import annotations

import numpy as np

from hhtbench.lowering.scalar_compiler.emit import MEMORY, Emitted, Writer, head, wrapper
from hhtbench.lowering.scalar_compiler.graph import Graph
from hhtbench.lowering.scalar_compiler.lu import HELPERS
from hhtbench.lowering.scalar_compiler.reroll import CONSTANT, KEPT, TRUTH, Form, Loop, Rerolled
from hhtbench.lowering.scalar_compiler.store import CALLS, CODES, Ids

FEW = 2  # turns that are written out


def emit_loops(graph: Graph, outputs: Ids, arguments: int, counts: Ids, limit: int) -> Emitted:
    """The function of :func:`~.emit.emit` in loops of at most ``limit`` operations.

    ``counts``: how often each node is :func:`~.dependencies.needed`.  The numbers kept are on the heap while it runs.
    """
    rerolled = Rerolled(graph, outputs, counts, limit)
    writer = _LoopWriter(rerolled)
    if np.any(graph.column("code")[outputs] == CODES["constant"]):
        writer.constants(outputs)
    for loop in rerolled.loops:
        writer.loop(loop)
    body = [
        f"{head(arguments)} {{",
        "start:",
        f"  %w = call noalias ptr @malloc(i64 {8 * rerolled.room})",
        *writer.lines,
        "  call void @free(ptr %w)",
        "  ret void",
        "}",
    ]
    writer.declarations |= {"declare noalias ptr @malloc(i64)", "declare void @free(ptr)"}
    text = [writer.table, *writer.tables.values(), *body, wrapper(arguments), *sorted(writer.declarations)]
    return Emitted("\n".join(text), "\n".join(writer.helpers.values()), writer.operations)


class _LoopWriter(Writer):
    """Lines of the loops."""

    def __init__(self, rerolled: Rerolled) -> None:
        super().__init__(rerolled.graph)
        self.rerolled = rerolled
        self.tables: dict[bytes, str] = {}  #: definitions of constant arrays by their content
        self._loops, self._values, self._block = 0, 0, "start"
        self._turn = ""  #: the number of the turn
        self._indices: dict[bytes, str] = {}  #: that this turn has read from tables

    def loop(self, loop: Loop) -> None:
        """The lines of one loop; what is the same in all turns is read before it, and what occurs twice is read once."""
        forms = self.rerolled.leaves(loop.form)
        if len(loop.targets) <= FEW:
            for places, target in zip(loop.sources.tolist(), loop.targets.tolist(), strict=True):
                self._evaluate(loop, list(map(self._leaf, forms, places)), str(target))
            return
        keys = [(form, places.tobytes()) for form, places in zip(forms, loop.sources.T, strict=True)]
        columns = dict(zip(keys, loop.sources.T, strict=True))
        same = {key: self._leaf(key[0], int(x[0])) for key, x in columns.items() if np.all(x == x[0])}
        self._loops += 1
        block, before = f"loop{self._loops}", self._block
        self._turn, self._block, self._indices = f"%{block}.turn", f"{block}.end", {}
        self.lines += [
            f"  br label %{block}",
            f"{block}:",
            f"  {self._turn} = phi i64 [ 0, %{before} ], [ %{block}.next, %{block} ]",
        ]
        read = {key: same.get(key) or self._leaf_of_turn(key[0], places) for key, places in columns.items()}
        self._evaluate(loop, [read[key] for key in keys], self._index(loop.targets))
        self.lines += [
            f"  %{block}.next = add nuw nsw i64 {self._turn}, 1",
            f"  %{block}.more = icmp ult i64 %{block}.next, {len(loop.targets)}",
            f"  br i1 %{block}.more, label %{block}, label %{block}.end",
            f"{block}.end:",
        ]

    def _line(self, text: str) -> str:
        self._values += 1
        self.lines.append(f"  %t{self._values} = {text}")
        return f"%t{self._values}"

    def _at(self, base: str, index: str, kind: str = "double") -> str:
        return self._line(f"getelementptr {kind}, ptr {base}, i64 {index}")

    def _leaf(self, form: int, place: int) -> str:
        """A number from a place, or the constant of these bits."""
        where = self.rerolled.forms[form]
        return f"0x{place & 0xFFFFFFFFFFFFFFFF:016X}" if where == CONSTANT else self._read(where, str(place))

    def _leaf_of_turn(self, form: int, places: Ids) -> str:
        where = self.rerolled.forms[form]
        if where == CONSTANT:
            return self._line(f"load double, ptr {self._at(self._table(places.tobytes()), self._turn)}, align 8")
        return self._read(where, self._index(places))

    def _read(self, where: Form, index: str) -> str:
        base = "%w" if where in (KEPT, TRUTH) else MEMORY[where[0]].format(*where[1:])
        number = self._line(f"load double, ptr {self._at(base, index)}, align 8")
        return self._line(f"fcmp one double {number}, 0.0") if where == TRUTH else number

    def _index(self, places: Ids) -> str:
        """The place of this turn: in even steps, or from a table that all share which differ by a constant."""
        steps = np.diff(places)
        even = bool(np.all(steps == steps[0]))
        first = int(places[0]) if even else int(places.min())
        offsets = (places - first).astype(np.int32).tobytes()
        if offsets not in self._indices:
            if even:
                self._indices[offsets] = self._line(f"mul nsw i64 {self._turn}, {steps[0]}")
            else:
                entry = self._line(f"load i32, ptr {self._at(self._table(offsets), self._turn, 'i32')}, align 4")
                self._indices[offsets] = self._line(f"zext i32 {entry} to i64")
        return self._line(f"add nsw i64 {self._indices[offsets]}, {first}")

    def _table(self, content: bytes) -> str:
        text = f'private unnamed_addr constant [{len(content)} x i8] c"\\{content.hex(chr(92))}", align 16'
        name = f"@table{len(self.tables)}"
        return self.tables.setdefault(content, f"{name} = {text}").split(" ", 1)[0]

    def _evaluate(self, loop: Loop, leaves: list[str], target: str) -> None:
        """The lines of one turn."""
        stack, rest = list[str](), iter(leaves)
        for part in self.rerolled.parts(loop.form):
            if self.rerolled.is_leaf(part):
                stack.append(next(rest))
                continue
            operation, parameters, *operands = self.rerolled.forms[part]
            first = len(stack) - len(operands)
            if operation in CALLS:
                self._call(operation, parameters, stack, self._at("%w", target))
                return
            if operation in ("true", "false"):
                stack.append(operation)
            else:
                self.operations += 1
                stack[first:] = [self._line(self.expression(operation, stack[first:]))]
        value = self._line(f"uitofp i1 {stack[0]} to double") if loop.truth else stack[0]
        self.lines.append(f"  store double {value}, ptr {self._at('%out' if loop.last else '%w', target)}, align 8")

    def _call(self, operation: str, parameters: tuple[int, int], entries: list[str], block: str) -> None:
        """Operands to the ``block``, then the call, which leaves its result there."""
        self.operations += len(entries)
        for place, entry in enumerate(entries):
            self.lines.append(f"  store double {entry}, ptr {self._at(block, str(place))}, align 8")
        if operation in HELPERS:
            self.solver(block, operation, parameters)
        else:
            parameter, size = parameters
            self.callback(block, self._at(block, str(len(entries))), parameter, size)
