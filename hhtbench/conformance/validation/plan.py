"""Plan of a validation: solvers, forms and tolerances."""

from __future__ import annotations

from hhtbench.campaign.plan import Campaign, Grid
from hhtbench.catalogue.specs import canonical

# Left out: diffrax(method=Kvaerno5), which compiles for a minute a problem; ida(form=index3), which works at loose
# tolerances only; the low-order methods of projected.  Any solver can be added by a campaign of its own.
PAIRS = (
    "ida(form=ggl)",
    "ida(form=index1)",
    "ida(form=integrated)",
    "ida(form=index2)",
    "cvode(form=ode, method=bdf)",
    "cvode(form=ode, method=adams)",
    "scipy(method=Radau)",
    "scipy(method=BDF)",
    "scipy(method=LSODA)",
    "scipy(method=DOP853)",
    "projected(method=DOP853)",
    "diffrax(method=Tsit5)",
    "diffrax(method=Dopri8)",
    "collocation(form=ggl)",
    "collocation(form=index1)",
)
MAKERS = ("collocation(form=ggl)", "collocation(form=index1)", "projected(method=DOP853)")  # makers of the references
STEPPED = (
    "hht",
    "generalised_alpha",
    "hht_i3",
    "rattle",
)  # constant steps; all but the first take position constraints only
RTOL = (1e-8, 1e-10)  # the better of the two is judged; what neither reaches must at least converge from one to the other
STEPS = (1_000, 3_000, 10_000, 50_000)
MAX_SECONDS = 60.0  # of one solve [s]
OUTPUTS = 11  # equal distances; the times of the reference are added


def validation_campaign(problems: tuple[str, ...], max_seconds: float = MAX_SECONDS) -> Campaign:
    """Return the campaign that validates ``problems`` (specs)."""
    return Campaign(
        grids=(
            Grid(problems=problems, solvers=PAIRS, rtol=RTOL),
            Grid(problems=problems, solvers=STEPPED, steps=STEPS),
        ),
        outputs=OUTPUTS,
        max_seconds=max_seconds,
        counting=False,
    )


def stepped(solver: str) -> bool:
    """True if the canonical spec is of a solver with constant steps."""
    return solver in {canonical(text) for text in STEPPED}
