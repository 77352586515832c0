"""The one judge: is the problem right, is a result believable, how far does it drift?

``problem``
    ``check`` measures what a problem promises: shapes, derivatives, a consistent start, rank, index.
``result``
    ``success.check_success`` checks every success that ``hb.solve`` returns, in a fraction of the time of the solve;
    ``judge.judge`` adds the equations of motion, for campaigns and ``solution.verify()``.
``drift``
    How far a solution leaves constraints, energy and invariants.
``times``
    Whether floating-point times resolve the steps of a solver; the only part that solvers import.
"""
