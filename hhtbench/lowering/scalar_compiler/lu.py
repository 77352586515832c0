"""The helper in LLVM assembly that solves a dense system with rows exchanged, of one size and number of right-hand sides."""

from __future__ import annotations

HELPERS = "hhtbench_solve"


def helper(n: int, r: int) -> str:
    """Assembly that solves (n, n) for (n, r) right-hand sides, both side by side in the rows of ``m`` (n, n + r), in place.

    LU with the largest pivot of each column.  A NaN loses every comparison of sizes, so a NaN column keeps its own row; a
    zero pivot divides to infinity or NaN.  LLVM's passes move what is on the stack here into registers.
    """
    width = n + r

    def at(name: str, row: str, column: str) -> str:
        return f"""
  %{name}.row = mul i64 {row}, {width}
  %{name}.at = add i64 %{name}.row, {column}
  %{name}.ptr = getelementptr double, ptr %m, i64 %{name}.at
  %{name} = load double, ptr %{name}.ptr"""

    def subtract(name: str, factor: str, row: str, other: str, column: str) -> str:
        return f"""{at(f"{name}.old", row, column)}{at(f"{name}.other", other, column)}
  %{name}.product = fmul double {factor}, %{name}.other
  %{name}.new = fsub double %{name}.old, %{name}.product
  store double %{name}.new, ptr %{name}.old.ptr"""

    search = f"""{at("s.value", "%s", "%k")}
  %s.size = call double @llvm.fabs.f64(double %s.value)
  %s.largest = load double, ptr %largest
  %s.best = load i64, ptr %best
  %s.larger = fcmp ogt double %s.size, %s.largest
  %s.largest.new = select i1 %s.larger, double %s.size, double %s.largest
  %s.best.new = select i1 %s.larger, i64 %s, i64 %s.best
  store double %s.largest.new, ptr %largest
  store i64 %s.best.new, ptr %best"""
    swap = f"""{at("w.one", "%k", "%w")}{at("w.other", "%swapped", "%w")}
  store double %w.one, ptr %w.other.ptr
  store double %w.other, ptr %w.one.ptr"""
    eliminate = f"""{at("i.value", "%i", "%k")}
  %i.factor = fdiv double %i.value, %pivot
  {_loop("j", "%k.below", width, subtract("j", "%i.factor", "%i", "%k", "%j"))}"""
    column = f"""
  store double -1.0, ptr %largest
  store i64 %k, ptr %best
  {_loop("s", "%k", n, search)}
  %swapped = load i64, ptr %best
  {_loop("w", "%k", width, swap)}{at("pivot", "%k", "%k")}
  %k.below = add i64 %k, 1
  {_loop("i", "%k.below", n, eliminate)}"""
    substitute = f"""{at("f.value", "%e", "%f")}
  {_loop("g", n, width, subtract("g", "%f.value", "%e", "%f", "%g"))}"""
    divide = f"""{at("o.value", "%e", "%o")}
  %o.result = fdiv double %o.value, %diagonal
  store double %o.result, ptr %o.value.ptr"""
    back = f"""
  %e = sub i64 {n - 1}, %d
  %e.below = add i64 %e, 1
  {_loop("f", "%e.below", n, substitute)}{at("diagonal", "%e", "%e")}
  {_loop("o", n, width, divide)}"""
    return f"""
define void @{HELPERS}_{n}_{r}(ptr noalias captures(none) %m) noinline nounwind {{
  %largest = alloca double
  %best = alloca i64
  {_loop("k", 0, n, column)}
  {_loop("d", 0, n, back)}
  ret void
}}
"""


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
