"""The helper in LLVM assembly that solves a dense system with rows exchanged, of one size and number of right-hand sides."""

from __future__ import annotations

HELPERS = "hhtbench_solve"


def helper(n: int, r: int) -> str:
    """Assembly that solves (n, n) for (n, r) right-hand sides, both side by side in the rows of ``m`` (n, n + r), in place.

    LU with the largest pivot of each column.  A NaN loses every comparison of sizes, so a NaN column keeps its own row; a
    zero pivot divides to infinity or NaN.  LLVM's passes move what is on the stack here into registers.
    """
    return f"""
define void @{HELPERS}_{n}_{r}(ptr noalias captures(none) %m) noinline nounwind {{
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
