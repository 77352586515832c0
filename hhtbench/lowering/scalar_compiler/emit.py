"""Writes live nodes of the scalar graph as straight-line LLVM assembly.

No fast-math: the values are those of the operations in the order given, as JAX's are but for roundoff.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from hhtbench.lowering.scalar_compiler.dependencies import needs
from hhtbench.lowering.scalar_compiler.graph import Graph
from hhtbench.lowering.scalar_compiler.lu import HELPERS, helper
from hhtbench.lowering.scalar_compiler.operations import FUNCTIONS, INSTRUCTIONS
from hhtbench.lowering.scalar_compiler.store import FALSE, TRUE, Ids

ENTRY, CALL = "hhtbench_f", "hhtbench_call"
READ = "ptr noalias readonly captures(none)"
WRITTEN = "ptr noalias writeonly captures(none)"
MEMORY = {"parameter": "%p", "argument": "%a{}", "entry": "%x{}"}  # where numbers are read from


class Emitted(NamedTuple):
    """Assembly of one function."""

    text: str
    helpers: str  #: functions with loops that it calls, or nothing
    operations: int  #: arithmetic and calls, without loads and stores


def bits(value: float) -> int:
    """Bit pattern of a float64 as an integer."""
    return int.from_bytes(struct.pack(">d", value))


def ordered(graph: Graph, outputs: list[int]) -> Iterator[int]:
    """Yield the nodes that outputs need, operands first, each output's as late as possible, which saves registers.

    In the order of tracing, code for 4,600 operations took twice as long to generate and a fifth longer to run.
    """
    seen: set[int] = set()
    for output in outputs:
        stack = [(output, False)]
        while stack:
            node, ready = stack.pop()
            if ready:
                yield node
            elif node not in seen:
                seen.add(node)
                stack.append((node, True))
                stack.extend((operand, False) for operand in reversed(needs(graph, node)) if operand not in seen)


def emit(graph: Graph, outputs: Ids, arguments: int) -> Emitted:
    """A function ``void f(out, parameters, a0, ...)`` that stores ``outputs`` in order, and one of all pointers in a row."""
    writer = Writer(graph)
    places: dict[int, list[int]] = {}
    for place, node in enumerate(outputs.tolist()):
        if node not in graph.number:
            places.setdefault(node, []).append(place)
    if outputs.size > sum(map(len, places.values())):
        writer.constants(outputs)
    for node in ordered(graph, list(places)):
        writer.node(node)
        for place in places.get(node, ()):
            writer.store("%out", place, node)
    body = [f"{head(arguments)} {{", *writer.scratch, *writer.lines, "  ret void", "}"]
    text = "\n".join([writer.table, *body, wrapper(arguments), *sorted(writer.declarations)])
    return Emitted(text, "\n".join(writer.helpers[key] for key in sorted(writer.helpers)), writer.operations)


def head(arguments: int) -> str:
    """Header line of the function's definition."""
    read = ", ".join([f"{READ} %p", *(f"{READ} %a{i}" for i in range(arguments))])
    return f"define void @{ENTRY}({WRITTEN} %out, {read}) nounwind"


def wrapper(arguments: int) -> str:
    """The function behind one pointer to all pointers: one argument is the cheapest call from Python."""
    lines = [f"define void @{CALL}(ptr readonly captures(none) %block) nounwind {{"]
    for i in range(arguments + 2):
        lines.append(f"  %q{i} = getelementptr ptr, ptr %block, i64 {i}")
        lines.append(f"  %r{i} = load ptr, ptr %q{i}")
    passed = ", ".join(f"ptr %r{i}" for i in range(arguments + 2))
    return "\n".join([*lines, f"  call void @{ENTRY}({passed})", "  ret void", "}"])


class Writer:
    """Writes the lines of one function body."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.table = ""  #: code of the table of the outputs' known entries
        self.lines: list[str] = []
        self.scratch: list[str] = []  #: stack space of the calls
        self.declarations: set[str] = set()
        self.helpers: dict[str, str] = {}
        self.operations = 0
        self.calls = 0  #: back into Python

    def name(self, node: int) -> str:
        """Text of a node as an operand."""
        if node in self.graph.number:
            return f"0x{bits(self.graph.number[node]):016X}"
        return {TRUE: "true", FALSE: "false"}.get(node, f"%v{node}")

    def node(self, node: int) -> None:
        """Write the lines of one node."""
        graph, operation = self.graph, self.graph.operation(node)
        x, y = graph.x[node], graph.y[node]
        if operation in MEMORY:
            base, place = MEMORY[operation].format(x), x if operation == "parameter" else y
            self.lines.append(f"  %g{node} = getelementptr double, ptr {base}, i64 {place}")
            self.lines.append(f"  %v{node} = load double, ptr %g{node}, align 8")
        elif operation in HELPERS:
            self.solve(node, operation, (x, y), needs(graph, node))
        elif operation == "foreign":
            self.foreign(node, x, y, needs(graph, node))
        elif operation not in ("constant", "true", "false"):
            self.operations += 1
            self.lines.append(
                f"  %v{node} = {self.expression(operation, [self.name(operand) for operand in needs(graph, node)])}"
            )

    def constants(self, outputs: Ids) -> None:
        """Entries that are known, in one copy from a table; the others are overwritten.

        Stores of ten thousand zeros one by one took LLVM minutes.
        """
        values = ", ".join(f"double {self.name(node) if node in self.graph.number else '0.0'}" for node in outputs.tolist())
        self.table = f"@constants = private unnamed_addr constant [{outputs.size} x double] [{values}], align 64"
        self.declarations.add("declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)")
        self.lines.append(f"  call void @llvm.memcpy.p0.p0.i64(ptr %out, ptr @constants, i64 {8 * outputs.size}, i1 false)")

    def store(self, base: str, place: int, node: int) -> None:
        """Write a store of one number to memory."""
        self.lines.append(f"  {base}.{place} = getelementptr double, ptr {base}, i64 {place}")
        self.lines.append(f"  store double {self.name(node)}, ptr {base}.{place}, align 8")

    def expression(self, operation: str, x: list[str]) -> str:
        """The right-hand side of an operation: an instruction, or a call of an intrinsic or of the C library."""
        if operation in INSTRUCTIONS:
            return INSTRUCTIONS[operation].format(*x)
        function = FUNCTIONS[operation]
        attributes = "" if function.startswith("llvm.") else " nounwind willreturn memory(none)"
        self.declarations.add(f"declare double @{function}({', '.join(['double'] * len(x))}){attributes}")
        return f"call double @{function}({', '.join(f'double {value}' for value in x)})"

    def room(self, base: str, size: int, entries: Sequence[int] = ()) -> None:
        """Room for ``size`` numbers on the stack, which begins with ``entries``."""
        self.operations += len(entries)
        self.scratch.append(f"  {base} = alloca [{size} x double], align 64")
        for place, entry in enumerate(entries):
            self.store(base, place, entry)

    def foreign(self, node: int, parameter: int, size: int, entries: Sequence[int]) -> None:
        """Write arguments to the stack, then the call of a Python function."""
        self.operations += 2 * size
        self.room(f"%m{node}", len(entries), entries)
        self.room(f"%x{node}", size)
        self.callback(f"%m{node}", f"%x{node}", parameter, size)

    def callback(self, arguments: str, result: str, parameter: int, size: int) -> None:
        """A call by the address in ``%p``; NaN is left where it does not write its result."""
        self.declarations.add("declare void @llvm.memset.p0.i64(ptr, i8, i64, i1)")
        self.calls += 1
        self.lines += [
            f"  call void @llvm.memset.p0.i64(ptr {result}, i8 -1, i64 {8 * size}, i1 false)",  # NaN
            f"  %c{self.calls}.at = getelementptr ptr, ptr %p, i64 {parameter}",
            f"  %c{self.calls} = load ptr, ptr %c{self.calls}.at, align 8",
            f"  call void %c{self.calls}(ptr {arguments}, ptr {result})",
        ]

    def solve(self, node: int, operation: str, sizes: tuple[int, int], entries: Sequence[int]) -> None:
        """Write matrix and right-hand sides to the stack, then the call of the solver."""
        self.room(f"%x{node}", len(entries), entries)
        self.solver(f"%x{node}", operation, sizes)

    def solver(self, block: str, operation: str, sizes: tuple[int, int]) -> None:
        """The helper, which leaves the solution in place of the right-hand sides."""
        name = f"{HELPERS[operation]}_{sizes[0]}_{sizes[1]}"
        self.helpers[name] = helper(operation, *sizes)
        self.declarations.add(f"declare void @{name}(ptr)")
        self.lines.append(f"  call void @{name}(ptr {block})")
