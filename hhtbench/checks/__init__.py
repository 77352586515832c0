"""The one judge: is the problem right, is a result believable, how far does it drift?

``problem``
    ``check`` measures what a problem promises: shapes, derivatives, a consistent start, rank, index.
``result``
    ``success.check_success`` checks every success that ``hb.solve`` returns, in a fraction of the time of the solve;
    ``judge.judge`` adds the equations of motion, for campaigns and ``solution.verify()``.
``drift``
    How far a solution leaves constraints, energy and invariants.
``jumps``
    Where the velocities of prescribed motions jump, and the impulse there.
``accuracy``
    ``hb.solve(accuracy=...)``: runs, finer and finer, until their error is shown to be small enough.
"""
