"""``RunRow``: one finished cell of a campaign, as the store holds it and the report reads it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, kw_only=True)
class RunRow:
    """One cell: one problem, one solver, one request, and what came of it.

    The mappings are plain JSON (numbers, text, lists, mappings, null).  No number is ever NaN or infinite: what could
    not be measured is null, or the key of an optional part is absent where that is said below.  A failed cell has the
    same keys, filled as far as its partial solution reaches; a declined, crashed or killed one has ``metrics == {}`` and
    ``series == {}``.

    ``request``
        Exactly one of ``rtol``, ``step``, ``steps`` is not null: ``{"rtol": 1e-06, "atol": null, "step": null,
        "steps": null, "outputs": 51, "counting": true, "max_seconds": 20.0}``.  ``outputs`` is the number of output times,
        equal distances over the interval (the times of the problem's reference are added); ``atol`` null means the
        solver's own choice; ``counting``: solvers that count in a run of their own were let to.  In a campaign that refines
        its settings also ``rules``: ``{"accuracies", "max_seconds", "pair_seconds", "refinements"}``, what every solver was
        given; ``held_out`` true on problems on which defaults were not tuned; ``reference``, digest of the
        certificate that the problem was given, and ``reference_file``, where it lies.

    ``metrics``
        ``system``: ``{"n", "m", "p", "tags"}``, the problem's numbers of coordinates, position and velocity constraints
        (null where its functions raise at the start), and its tags.  ``t_end``: last time reached [s].  ``reached``:
        fraction of the interval, 0 to 1.  ``rows``: output rows.

        ``call``: ``{"evaluates", "operations", "of_residual"}``, what one of the solver's residual evaluations is, its
        operations, and those of a residual of the problem's equations; null where they are not known.

        ``errors``: absent where the problem has neither exact solution nor reference, or no row meets one.  It holds
        ``against``: "exact" or "reference"; ``digits``: verified digits of the reference or null; ``points``: number
        of times compared; and one entry for each of ``q``, ``v``, ``lam``, ``mu`` that the problem has, and
        ``observables``: {name: entry}.  ``lam`` and ``mu`` are those that follow from q and v at the acceleration
        level; ``lam_carried`` and ``mu_carried``, absent where the solver holds none, are its own: at the output rows,
        or for HHT its stage values at those ends of steps where something is known.  An entry is ``{"end",
        "end_scaled", "max", "max_scaled"}``: largest component of |error| at the end of the interval and over all
        compared times; ``_scaled``: every component over its scale first (``problem.scales``; for an observable the
        largest size of its true value over the compared times).  ``end`` and ``end_scaled`` are null where the end was
        not reached.  ``unknown``, absent where it is 0: rows that are left out as multipliers there are nan, which trust
        allows where the constraints lose rank; where all are, the errors are null.

        ``drift``: ``{"position", "velocity", "acceleration", "position_absolute", "velocity_absolute", "energy",
        "invariants", "sampled", "points", "acceleration_note"}``, each a maximum over time.  ``position``: |g_i| /
        sum_j |g_q,ij| s_q,j.  ``velocity``: g_t + g_q v and k, over their row's size with s_v.  ``acceleration``:
        the constraints' second (k: first) derivative with the accelerations that follow from the multipliers the
        solver itself holds, over the largest size of its terms in the run, at every step, of more than 5,000 at as
        many from the first to the last; null where it holds none, which ``acceleration_note`` says: those recovered
        from that very level would make it zero.  It says too where some of them are nan, and left out.
        ``_absolute``: max |g_i| and max |g_t + g_q v|_i or |k_i|, in their own units.  ``energy``: change since the
        start over the larger of its own and the kinetic energy's size.  ``invariants``: {name: change over the
        value at the start, or over 1 where that is zero}. Null (or {}) where the system has no such level or
        declares none.  ``sampled``: "steps" (all internal steps) or, where the solver tells none, "rows";
        ``points``: how many there were.

    ``series``
        For plots, each at most 100 points of six digits.  ``drift``: ``{"t", "position", "velocity", "energy", "invariants":
        {name: [...]}}``, thinned so that the largest value in each span of time stays; a level that does not exist is
        absent.  ``acceleration``: ``{"t", "value"}`` or absent.  ``errors``: ``{"t", "q", "v", "lam", "mu"}`` scaled errors
        at the compared times, components as in ``metrics``; absent like ``metrics["errors"]``.  ``multipliers``: ``{"t",
        "lam": [[...] per time], "mu": [[...] per time]}`` at the output rows, at most 12 components of each.  ``states``:
        ``{"t", "q", "v"}`` at up to 11 of them, whole, for comparing runs two by two.  ``steps``:
        ``{"t", "h"}`` ends and lengths of internal steps; absent where the solver keeps none.

    ``counters``
        The fields of :class:`~hhtbench.Counters`: numbers, or null where not reported, and ``provenance``; of a
        solve without output before the end, so ``output_evaluations`` (in no other counter) are those of one row.
        ``{}`` where no solve came back.

    ``timing``
        ``compile_s``: wall time of the warm-up of this solver on this problem, compilation included; what solvers before
        it have compiled or left in the cache on disk is not compiled again.  ``solve_s``: one warm solve beside other work.
        ``solve_cpu_s``: its processor time.  ``rounds_s``: processor times of warm solves, each reading taken alone on a
        core with one thread, one in every round over all cells; ``best_s`` and ``median_s`` of them (of an even number the
        lower median), ``repeats`` how many.  Of the median reading: ``solves``, how many it lasted for, ``wall_s``, the wall
        time of one, ``load`` the machine's average of running tasks over the last minute (null where the system does not
        tell), ``disturbed`` true where the wall time is more than 1.2 times the processor time: the process waited.  All are
        null until the timing pass has run, and for a cell that did not succeed.  ``note``: only where a timed solve failed
        (then ``repeats`` is 0).  Every solve here is one without output before the end.  ``{}`` where no solve came back.

    ``environment``
        ``{"python", "system", "machine", "processor", "cores", "memory_GiB", "hhtbench", "commit", "numpy", ...}``: text
        and numbers, the same for all cells of one machine and tree; where and with what the cell was solved, ``commit`` that
        of hhtbench's own tree ("-dirty": with changes).
    """

    key: str  #: content hash of specs, request, sources and versions
    problem: str  #: canonical spec, "planar_chain(n_links=100)"
    solver: str  #: canonical spec, "ida(form='ggl')"
    request: dict[str, Any]
    status: str  #: label of a :class:`~hhtbench.Status`: "success", "declined", "crashed", ...
    message: str  #: what happened and what to do; the reason of a declined cell
    metrics: dict[str, Any] = field(default_factory=dict)
    series: dict[str, Any] = field(default_factory=dict)
    counters: dict[str, Any] = field(default_factory=dict)
    timing: dict[str, Any] = field(default_factory=dict)
    environment: dict[str, Any] = field(default_factory=dict)
    created: str = ""  #: UTC, ISO 8601

    @property
    def success(self) -> bool:
        """True when the end of the interval (or a terminal event) was reached."""
        return self.status in ("success", "event")
