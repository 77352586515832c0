"""The helper in LLVM assembly that solves a dense system with rows exchanged, of one size and number of right-hand sides."""

from __future__ import annotations

HELPERS = "hhtbench_solve"

_TEMPLATE = """
define void @{name}(ptr noalias captures(none) %m, ptr noalias captures(none) %x) noinline nounwind {{
entry:
  br label %column
column:
  %k = phi i64 [ 0, %entry ], [ %k.next, %column.end ]
  %k.done = icmp eq i64 %k, {n}
  br i1 %k.done, label %back, label %search
search:
  br label %search.loop
search.loop:
  %s = phi i64 [ %k, %search ], [ %s.next, %search.body ]
  %best = phi i64 [ %k, %search ], [ %best.next, %search.body ]
  %largest = phi double [ -1.0, %search ], [ %largest.next, %search.body ]
  %s.done = icmp eq i64 %s, {n}
  br i1 %s.done, label %swap, label %search.body
search.body:
  %s.row = mul i64 %s, {n}
  %s.at = add i64 %s.row, %k
  %s.ptr = getelementptr double, ptr %m, i64 %s.at
  %s.value = load double, ptr %s.ptr
  %s.size = call double @llvm.fabs.f64(double %s.value)
  %s.more = fcmp ogt double %s.size, %largest
  %largest.next = select i1 %s.more, double %s.size, double %largest
  %best.next = select i1 %s.more, i64 %s, i64 %best
  %s.next = add i64 %s, 1
  br label %search.loop
swap:
  %k.row = mul i64 %k, {n}
  %b.row = mul i64 %best, {n}
  %kx.row = mul i64 %k, {r}
  %bx.row = mul i64 %best, {r}
  %same = icmp eq i64 %best, %k
  br i1 %same, label %eliminate, label %swap.loop
swap.loop:
  %w = phi i64 [ 0, %swap ], [ %w.next, %swap.body ]
  %w.done = icmp eq i64 %w, {n}
  br i1 %w.done, label %swapx.loop, label %swap.body
swap.body:
  %w.ka = add i64 %k.row, %w
  %w.ba = add i64 %b.row, %w
  %w.kp = getelementptr double, ptr %m, i64 %w.ka
  %w.bp = getelementptr double, ptr %m, i64 %w.ba
  %w.kv = load double, ptr %w.kp
  %w.bv = load double, ptr %w.bp
  store double %w.bv, ptr %w.kp
  store double %w.kv, ptr %w.bp
  %w.next = add i64 %w, 1
  br label %swap.loop
swapx.loop:
  %u = phi i64 [ 0, %swap.loop ], [ %u.next, %swapx.body ]
  %u.done = icmp eq i64 %u, {r}
  br i1 %u.done, label %eliminate, label %swapx.body
swapx.body:
  %u.ka = add i64 %kx.row, %u
  %u.ba = add i64 %bx.row, %u
  %u.kp = getelementptr double, ptr %x, i64 %u.ka
  %u.bp = getelementptr double, ptr %x, i64 %u.ba
  %u.kv = load double, ptr %u.kp
  %u.bv = load double, ptr %u.bp
  store double %u.bv, ptr %u.kp
  store double %u.kv, ptr %u.bp
  %u.next = add i64 %u, 1
  br label %swapx.loop
eliminate:
  %d.at = add i64 %k.row, %k
  %d.ptr = getelementptr double, ptr %m, i64 %d.at
  %pivot = load double, ptr %d.ptr
  %k.next = add i64 %k, 1
  br label %row
row:
  %i = phi i64 [ %k.next, %eliminate ], [ %i.next, %row.end ]
  %i.done = icmp eq i64 %i, {n}
  br i1 %i.done, label %column.end, label %row.body
row.body:
  %i.row = mul i64 %i, {n}
  %ix.row = mul i64 %i, {r}
  %i.at = add i64 %i.row, %k
  %i.ptr = getelementptr double, ptr %m, i64 %i.at
  %i.value = load double, ptr %i.ptr
  %factor = fdiv double %i.value, %pivot
  br label %j.loop
j.loop:
  %j = phi i64 [ %k.next, %row.body ], [ %j.next, %j.body ]
  %j.done = icmp eq i64 %j, {n}
  br i1 %j.done, label %jx.loop, label %j.body
j.body:
  %j.ka = add i64 %k.row, %j
  %j.ia = add i64 %i.row, %j
  %j.kp = getelementptr double, ptr %m, i64 %j.ka
  %j.ip = getelementptr double, ptr %m, i64 %j.ia
  %j.kv = load double, ptr %j.kp
  %j.iv = load double, ptr %j.ip
  %j.pr = fmul double %factor, %j.kv
  %j.nv = fsub double %j.iv, %j.pr
  store double %j.nv, ptr %j.ip
  %j.next = add i64 %j, 1
  br label %j.loop
jx.loop:
  %l = phi i64 [ 0, %j.loop ], [ %l.next, %jx.body ]
  %l.done = icmp eq i64 %l, {r}
  br i1 %l.done, label %row.end, label %jx.body
jx.body:
  %l.ka = add i64 %kx.row, %l
  %l.ia = add i64 %ix.row, %l
  %l.kp = getelementptr double, ptr %x, i64 %l.ka
  %l.ip = getelementptr double, ptr %x, i64 %l.ia
  %l.kv = load double, ptr %l.kp
  %l.iv = load double, ptr %l.ip
  %l.pr = fmul double %factor, %l.kv
  %l.nv = fsub double %l.iv, %l.pr
  store double %l.nv, ptr %l.ip
  %l.next = add i64 %l, 1
  br label %jx.loop
row.end:
  %i.next = add i64 %i, 1
  br label %row
column.end:
  br label %column
back:
  %e = phi i64 [ {n}, %column ], [ %e.next, %divide.end ]
  %e.done = icmp eq i64 %e, 0
  br i1 %e.done, label %exit, label %back.body
back.body:
  %e.next = sub i64 %e, 1
  %e.row = mul i64 %e.next, {n}
  %ex.row = mul i64 %e.next, {r}
  br label %f.loop
f.loop:
  %f = phi i64 [ %e, %back.body ], [ %f.next, %f.end ]
  %f.done = icmp eq i64 %f, {n}
  br i1 %f.done, label %divide, label %f.body
f.body:
  %f.at = add i64 %e.row, %f
  %f.ptr = getelementptr double, ptr %m, i64 %f.at
  %f.value = load double, ptr %f.ptr
  %fx.row = mul i64 %f, {r}
  br label %g.loop
g.loop:
  %g = phi i64 [ 0, %f.body ], [ %g.next, %g.body ]
  %g.done = icmp eq i64 %g, {r}
  br i1 %g.done, label %f.end, label %g.body
g.body:
  %g.ka = add i64 %fx.row, %g
  %g.ia = add i64 %ex.row, %g
  %g.kp = getelementptr double, ptr %x, i64 %g.ka
  %g.ip = getelementptr double, ptr %x, i64 %g.ia
  %g.kv = load double, ptr %g.kp
  %g.iv = load double, ptr %g.ip
  %g.pr = fmul double %f.value, %g.kv
  %g.nv = fsub double %g.iv, %g.pr
  store double %g.nv, ptr %g.ip
  %g.next = add i64 %g, 1
  br label %g.loop
f.end:
  %f.next = add i64 %f, 1
  br label %f.loop
divide:
  %h.at = add i64 %e.row, %e.next
  %h.ptr = getelementptr double, ptr %m, i64 %h.at
  %h.value = load double, ptr %h.ptr
  br label %o.loop
o.loop:
  %o = phi i64 [ 0, %divide ], [ %o.next, %o.body ]
  %o.done = icmp eq i64 %o, {r}
  br i1 %o.done, label %divide.end, label %o.body
o.body:
  %o.at = add i64 %ex.row, %o
  %o.ptr = getelementptr double, ptr %x, i64 %o.at
  %o.value = load double, ptr %o.ptr
  %o.result = fdiv double %o.value, %h.value
  store double %o.result, ptr %o.ptr
  %o.next = add i64 %o, 1
  br label %o.loop
divide.end:
  br label %back
exit:
  ret void
}}
"""


def helper(n: int, r: int) -> str:
    """Assembly that solves (n, n) ``m`` for (n, r) ``x`` in place, LU with the largest pivot of each column.

    A NaN loses every comparison of sizes, so a NaN column keeps its own row; a zero pivot divides to infinity or NaN.
    """
    return _TEMPLATE.format(name=f"{HELPERS}_{n}_{r}", n=n, r=r)
