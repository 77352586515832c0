"""Checks of problems and results: is the problem right, is a result believable, how far does it drift?

``problem``
    ``check`` measures what a problem states: shapes, derivatives, a consistent start, rank, index.
``result``
    ``success.check_success`` checks every success that ``hb.solve`` returns, in a fraction of the time of the solve;
    ``judge.judge`` adds the equations of motion, for campaigns and ``solution.verify()``.
``drift``
    Deviation of a solution from constraints, energy and invariants.
``jumps``
    Times at which velocities of prescribed motions jump, and the impulses there.
``accuracy``
    ``hb.solve(accuracy=...)``: runs with finer and finer settings until their error is shown to be small enough.
"""
