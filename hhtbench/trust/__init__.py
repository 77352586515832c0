"""What speaks against the success that a solver reports, whoever wrote it.

``doubt_about`` and ``doubt_about_motion`` look at types, shapes, times and counters, ``violated`` at the constraints,
``unknown_without_reason`` at multipliers that are nan, ``frozen`` at rows that are all one, and ``unresolved`` at the times
of steps.  :mod:`~hhtbench.trust.judge` adds the equations of motion, for the bench.
"""

from hhtbench.trust.frozen import frozen
from hhtbench.trust.levels import violated
from hhtbench.trust.rank import unknown_without_reason
from hhtbench.trust.rows import doubt_about, doubt_about_motion
from hhtbench.trust.times import unresolved

__all__ = ["doubt_about", "doubt_about_motion", "frozen", "unknown_without_reason", "unresolved", "violated"]
