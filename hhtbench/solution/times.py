"""Check whether floating-point times resolve the steps of a solver.

A solver makes a step of h and moves its time to t + h, rounded.  Far from t = 0 the two differ by up to half the spacing of
floating-point times in every step, mostly in the same direction, and the run covers an interval of another length.
"""

from __future__ import annotations

import math

from hhtbench.protocol.printing import exact
from hhtbench.solution.result import Status

SPACINGS = 10.0  # spacings of floating-point times: an error in time that no solver avoids
FINEST = 1e-10  # smallest relative error expected after many steps
END_SPACINGS = 100.0  # from the end of the interval, within which SUNDIALS takes it as reached


def unresolved(t_span: tuple[float, float], steps: int, rtol: float, elapsed: float | None = None) -> str:
    """Return the reason why floating-point times do not resolve ``steps`` steps over ``t_span`` [s]; "" if they do.

    ``elapsed`` is the sum of the signed lengths that the solver has used [s].  If it is None, every step is taken to be off
    by half a spacing.
    """
    t0, t1 = t_span
    span, spacing = t1 - t0, math.ulp(max(abs(t0), abs(t1)))
    text = Status.time_resolution.text
    if span == 0.0:
        return ""
    if (steps - 1) * spacing > abs(span):
        return f"{steps} steps over {exact(abs(span))} s from t = {exact(t0)} on are more than there are times. {text}"
    off = (steps / 2 + END_SPACINGS) * spacing if elapsed is None else abs(elapsed - span)
    if off <= max(max(rtol, FINEST) * abs(span), SPACINGS * spacing):
        return ""
    verb = "may be" if elapsed is None else "are"
    return (
        f"The lengths of the {steps} steps {verb} {off:.2g} s off the {exact(abs(span))} s from t = {exact(t0)} to "
        f"{exact(t1)}, where times are {spacing:.2g} s apart. {text}"
    )
