"""What speaks against the success that a solver reports, whoever wrote it.

:func:`check_success` is the check that ``hb.solve`` makes of every success, in a fraction of the time of the solve.
:mod:`~hhtbench.trust.judge` adds the equations of motion, for campaigns and ``solution.verify()``.  ``unresolved`` tells a
solver whether times resolve its steps.
"""

from hhtbench.trust.success import check_success
from hhtbench.trust.times import unresolved

__all__ = ["check_success", "unresolved"]
