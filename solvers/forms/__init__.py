"""Index-reduced forms of one system, derived from its Dynamics: what DAE and ODE libraries integrate.

Equations, symbols as in :mod:`hhtbench.protocol.system` (Q is the reaction of the position constraints, Qk that of the
velocity constraints):

    (F1)  q' = v - g_q^T eta
    (F2)  M(t, q) v' = F(t, q, v) + Q(t, q, lam) + Qk(t, q, v, mu)
    (F3)  0 = g(t, q)
    (F4)  0 = g_t + g_q v
    (F5)  0 = g_q v' + c,   c = g_tt + 2 g_tq v + g_qq(v, v)
    (F6)  0 = k(t, q, v)
    (F7)  0 = k_v v' + d,   d = k_t + k_q v
    (F8)  Lam' = lam,  Mu' = mu,  Eta' = eta
    (F9)  [M, -Q_lam, -Qk_mu; g_q, 0, 0; k_v, 0, 0] [v'; lam; mu] = [F; -c; -d]

============  ====  ===========================  ==================================================================
form          kind  unknowns                     equations
============  ====  ===========================  ==================================================================
index3        dae   q, v, lam, mu                (F1) without eta, (F2), (F3), (F6)
index2        dae   q, v, lam, mu                (F1) without eta, (F2), (F4), (F6)
ggl           dae   q, v, lam, mu, eta           (F1), (F2), (F3), (F4), (F6): stabilised index 2
index1        dae   q, v, lam, mu                (F1) without eta, (F2), (F5), (F7)
integrated    dae   q, v, Lam, Mu, Eta           ggl with lam, mu, eta replaced by the derivatives in (F8)
ode           ode   q, v                         q' = v and v' of (F9); needs Q linear in lam, Qk in mu
============  ====  ===========================  ==================================================================

``eta`` vanishes on every solution: (F4) and the time derivative of (F3) along (F1) leave ``g_q g_q^T eta = 0``.
``c`` and ``d`` are Dynamics' ``constraint_acceleration`` and ``velocity_constraint_acceleration``.  What a system does
not declare has no rows and no unknowns: without position constraints there is no eta (ggl is index2, integrated has
Mu only), without any constraint index1 is ``q' = v, M v' = F``.

Sources: Gear, Leimkuhler, Gupta, J. Comput. Appl. Math. 12-13 (1985) 77-90 (ggl); Gear, SIAM J. Sci. Stat. Comput. 9 (1988)
39-47 (integrated); Hairer and Wanner, Solving Ordinary Differential Equations II, section VII.1 and VII.2 (all).
"""

from solvers.forms.form import FORMS, MASKED, Form, Start, make_form, refusal
from solvers.forms.underlying import rhs_function

__all__ = ["FORMS", "MASKED", "Form", "Start", "make_form", "refusal", "rhs_function"]
