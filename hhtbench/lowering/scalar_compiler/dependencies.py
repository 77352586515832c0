"""Dependencies between nodes of the scalar graph, computed generation by generation with arrays.

Nodes of one generation need only those of earlier ones.
"""

from __future__ import annotations

import numpy as np

from hhtbench.lowering.scalar_compiler.store import ARITIES, ARITY, BOOLEAN, CALLS, CODES, NAMES, Ids, Store

IS_CALL = np.isin(NAMES, CALLS)
CONSTANT_HERE = "sign", "ceil", "floor", "trunc", "round_away", "round_even"  # but for jumps: without a derivative
STEPS = BOOLEAN | np.isin(NAMES, CONSTANT_HERE)


def needs(graph: Store, node: int) -> list[int]:
    """Operands of one node."""
    if node in graph.operands:
        return graph.operands[node].tolist()
    return [graph.x[node], graph.y[node], graph.z[node]][: ARITIES[graph.code[node]]]


def operands(graph: Store, nodes: Ids) -> tuple[Ids, Ids]:
    """Operands of ``nodes``, and for each the index of the node that needs it."""
    code = graph.column("code")[nodes]
    found, who = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for i, name in enumerate("xyz"):
        has = np.flatnonzero(ARITY[code] > i)
        if not has.size:
            break
        found.append(graph.column(name)[nodes[has]])
        who.append(has)
    for place in np.flatnonzero(IS_CALL[code]).tolist() if graph.operands else ():
        found.append(graph.operands[int(nodes[place])])
        who.append(np.full(found[-1].size, place))
    return np.concatenate(found), np.concatenate(who)


def generations(graph: Store, nodes: Ids) -> list[Ids]:
    """``nodes`` split by generation, the first one first."""
    depth = graph.column("depth")[nodes]
    short = depth.astype(np.uint16) if depth.max(initial=0) < 2**16 else depth  # sorted in a tenth of the time
    order = np.argsort(short, kind="stable")
    return np.split(nodes[order], np.flatnonzero(np.diff(depth[order])) + 1)


def needed(graph: Store, outputs: Ids) -> Ids:
    """For every node, the number of nodes or entries of the result that need its value."""
    varying = outputs[graph.column("code")[outputs] != CODES["constant"]]
    counts = np.bincount(varying, minlength=len(graph.code)).astype(np.int32)
    for nodes in reversed(generations(graph, np.arange(varying.max(initial=-1) + 1, dtype=np.int32))):
        live = nodes[counts[nodes] > 0]
        if live.size:
            np.add.at(counts, operands(graph, live)[0], 1)
    return counts


def depending(graph: Store, nodes: Ids, which: Ids) -> np.ndarray:
    """(all nodes,) mask of ``which`` and the nodes that depend on them; ``nodes`` must include all operands."""
    late = np.zeros(len(graph.code), dtype=bool)
    late[which] = True
    for generation in generations(graph, nodes):
        found, who = operands(graph, generation)
        late[generation[who[late[found]]]] = True
    return late


def pattern(graph: Store, outputs: Ids, argument: int) -> tuple[Ids, Ids]:
    """Rows and columns, row by row, of the possible nonzeros of the derivative of ``outputs`` by an argument."""
    live = np.flatnonzero(needed(graph, outputs))
    code, x, y = (graph.column(name) for name in ("code", "x", "y"))
    unknowns = live[(code[live] == CODES["argument"]) & (x[live] == argument)]
    carries = depending(graph, live[~STEPS[code[live]]], unknowns)
    sets = _Sets(code.size, unknowns, y[unknowns])
    for nodes in generations(graph, live[carries[live] & (code[live] != CODES["argument"])]):
        found, who = operands(graph, nodes)
        carried = carries[found]
        sets.unite(nodes, found[carried], who[carried])
    return sets.of(outputs)


class _Sets:
    """Sets of integers, one per node; nodes with equal sets may share storage."""

    def __init__(self, nodes: int, of: Ids, members: Ids) -> None:
        self.first, self.count = np.zeros(nodes, dtype=np.int64), np.zeros(nodes, dtype=np.int32)
        self.first[of], self.count[of] = np.arange(of.size), 1
        self.size, self.members, self.range = of.size, np.array(members, dtype=np.int32), int(members.max(initial=0)) + 1

    def of(self, nodes: Ids) -> tuple[Ids, Ids]:
        """Index into ``nodes`` and member for all members of their sets."""
        count = self.count[nodes]
        ends = np.cumsum(count)
        where = np.arange(ends[-1] if ends.size else 0) + np.repeat(self.first[nodes] - ends + count, count)
        return np.repeat(np.arange(nodes.size), count), self.members[where]

    def unite(self, nodes: Ids, parts: Ids, who: Ids) -> None:
        """Form the sets of ``nodes`` as unions of those of ``parts``; ``who``: index of the node of each part."""
        alone = np.bincount(who, minlength=nodes.size)[who] == 1
        self.first[nodes[who[alone]]], self.count[nodes[who[alone]]] = self.first[parts[alone]], self.count[parts[alone]]
        place, members = self.of(parts[~alone])
        pairs = np.sort(who[~alone][place] * self.range + members)  # NumPy's unique hashes, which takes thrice as long
        rows, columns = np.divmod(pairs[np.diff(pairs, prepend=-1) != 0], self.range)
        last = self.size + columns.size
        if last > self.members.size:
            self.members = np.resize(self.members, 2 * last)
        self.members[self.size : last] = columns
        some, first, count = np.unique(rows, return_index=True, return_counts=True)
        self.first[nodes[some]], self.count[nodes[some]] = self.size + first, count
        self.size = last
