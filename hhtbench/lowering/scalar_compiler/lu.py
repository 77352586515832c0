"""Helpers in LLVM assembly: solves with a dense matrix, rows exchanged, and with the Cholesky factors of a band."""

from __future__ import annotations

HELPERS = {"solve": "hhtbench_solve", "banded": "hhtbench_banded"}  # by operation


def helper(operation: str, n: int, k: int) -> str:
    """Assembly of the helper of ``operation`` for its sizes."""
    return _dense(n, k) if operation == "solve" else _banded(n, k)


def _banded(n: int, w: int) -> str:
    """Assembly that solves L L^T x = x in place; ``m``: L (n, w + 1) with reciprocal pivots, row by row, then x (n,)."""
    known = f"""{_load("x.factor", "%i", "%x", w + 1)}{_of_solution("x.known", "%i", f"%x, {w}", n, w)}
  %x.product = fmul double %x.factor, %x.known
  %x.sum = load double, ptr %sum
  %x.rest = fsub double %x.sum, %x.product
  store double %x.rest, ptr %sum"""
    forward = f"""{_of_solution("i.value", "%i", "0, 0", n, w)}
  store double %i.value, ptr %sum
  %i.ahead = sub i64 {w}, %i
  %i.inside = icmp sgt i64 %i.ahead, 0
  %i.first = select i1 %i.inside, i64 %i.ahead, i64 0
  {_loop("x", "%i.first", w, known)}{_load("i.pivot", "%i", str(w), w + 1)}
  %i.sum = load double, ptr %sum
  %i.solved = fmul double %i.sum, %i.pivot
  store double %i.solved, ptr %i.value.ptr"""
    pending = f"""{_load("y.factor", "%e", "%y", w + 1)}{_of_solution("y.old", "%e", f"%y, {w}", n, w)}
  %y.product = fmul double %y.factor, %e.solved
  %y.new = fsub double %y.old, %y.product
  store double %y.new, ptr %y.old.ptr"""
    backward = f"""
  %e = sub i64 {n - 1}, %d{_of_solution("e.value", "%e", "0, 0", n, w)}{_load("e.pivot", "%e", str(w), w + 1)}
  %e.solved = fmul double %e.value, %e.pivot
  store double %e.solved, ptr %e.value.ptr
  %e.ahead = sub i64 {w}, %e
  %e.inside = icmp sgt i64 %e.ahead, 0
  %e.first = select i1 %e.inside, i64 %e.ahead, i64 0
  {_loop("y", "%e.first", w, pending)}"""
    return f"""
define void @{HELPERS["banded"]}_{n}_{w}(ptr noalias captures(none) %m) noinline nounwind {{
  %sum = alloca double
  {_loop("i", 0, n, forward)}
  {_loop("d", 0, n, backward)}
  ret void
}}
"""


def _of_solution(name: str, row: str, shift: str, n: int, w: int) -> str:
    """The entry of x in the place ``row`` plus the difference of the two numbers in ``shift``."""
    return f"""
  %{name}.shift = sub i64 {shift}
  %{name}.row = add i64 {row}, %{name}.shift
  %{name}.at = add i64 %{name}.row, {n * (w + 1)}
  %{name}.ptr = getelementptr double, ptr %m, i64 %{name}.at
  %{name} = load double, ptr %{name}.ptr"""


def _dense(n: int, r: int) -> str:
    """Assembly that solves (n, n) for (n, r) right-hand sides, both side by side in the rows of ``m`` (n, n + r), in place.

    LU with the largest pivot of each column.  A NaN loses every comparison of sizes, so a NaN column keeps its own row; a
    zero pivot divides to infinity or NaN.  LLVM's passes move what is on the stack here into registers.
    """
    return f"""
define void @{HELPERS["solve"]}_{n}_{r}(ptr noalias captures(none) %m) noinline nounwind {{
  %largest = alloca double
  %best = alloca i64
  {_loop("k", 0, n, _eliminated(n, n + r))}
  {_loop("d", 0, n, _substituted(n, n + r))}
  ret void
}}
"""


def _eliminated(n: int, width: int) -> str:
    """Column ``k`` below the diagonal, after its largest entry has come to that."""
    search = f"""{_load("s.value", "%s", "%k", width)}
  %s.size = call double @llvm.fabs.f64(double %s.value)
  %s.largest = load double, ptr %largest
  %s.best = load i64, ptr %best
  %s.larger = fcmp ogt double %s.size, %s.largest
  %s.largest.new = select i1 %s.larger, double %s.size, double %s.largest
  %s.best.new = select i1 %s.larger, i64 %s, i64 %s.best
  store double %s.largest.new, ptr %largest
  store i64 %s.best.new, ptr %best"""
    swap = f"""{_load("w.one", "%k", "%w", width)}{_load("w.other", "%swapped", "%w", width)}
  store double %w.one, ptr %w.other.ptr
  store double %w.other, ptr %w.one.ptr"""
    eliminate = f"""{_load("i.value", "%i", "%k", width)}
  %i.factor = fdiv double %i.value, %pivot
  {_loop("j", "%k.below", width, _subtracted("j", "%i.factor", "%i", "%k", width))}"""
    return f"""
  store double -1.0, ptr %largest
  store i64 %k, ptr %best
  {_loop("s", "%k", n, search)}
  %swapped = load i64, ptr %best
  {_loop("w", "%k", width, swap)}{_load("pivot", "%k", "%k", width)}
  %k.below = add i64 %k, 1
  {_loop("i", "%k.below", n, eliminate)}"""


def _substituted(n: int, width: int) -> str:
    """Row ``n - 1 - d`` of the solution."""
    substitute = f"""{_load("f.value", "%e", "%f", width)}
  {_loop("g", n, width, _subtracted("g", "%f.value", "%e", "%f", width))}"""
    divide = f"""{_load("o.value", "%e", "%o", width)}
  %o.result = fdiv double %o.value, %diagonal
  store double %o.result, ptr %o.value.ptr"""
    return f"""
  %e = sub i64 {n - 1}, %d
  %e.below = add i64 %e, 1
  {_loop("f", "%e.below", n, substitute)}{_load("diagonal", "%e", "%e", width)}
  {_loop("o", n, width, divide)}"""


def _load(name: str, row: str, column: str, width: int) -> str:
    return f"""
  %{name}.row = mul i64 {row}, {width}
  %{name}.at = add i64 %{name}.row, {column}
  %{name}.ptr = getelementptr double, ptr %m, i64 %{name}.at
  %{name} = load double, ptr %{name}.ptr"""


def _subtracted(i: str, factor: str, row: str, other: str, width: int) -> str:
    """An entry of ``row`` less ``factor`` times that of the ``other`` in the column ``i``."""
    return f"""{_load(f"{i}.old", row, f"%{i}", width)}{_load(f"{i}.other", other, f"%{i}", width)}
  %{i}.product = fmul double {factor}, %{i}.other
  %{i}.new = fsub double %{i}.old, %{i}.product
  store double %{i}.new, ptr %{i}.old.ptr"""


def _loop(i: str, start: str | int, stop: int, body: str) -> str:
    """``body`` for every ``i`` from ``start`` to before ``stop``."""
    return f"""br label %{i}.start
{i}.start:
  br label %{i}.head
{i}.head:
  %{i} = phi i64 [ {start}, %{i}.start ], [ %{i}.next, %{i}.turn ]
  %{i}.more = icmp slt i64 %{i}, {stop}
  br i1 %{i}.more, label %{i}.body, label %{i}.end
{i}.body:{body}
  br label %{i}.turn
{i}.turn:
  %{i}.next = add i64 %{i}, 1
  br label %{i}.head
{i}.end:"""
