"""How often the bench doubts an honest solve, and how many lies it finds: the library, every solver, many tolerances.

``python -m tests.performance.trust [--only honest|lies] [PROBLEM ...]``; half an hour for all.  An honest solve that is
doubted is listed with its error: whether it deserves that is for the reader.  The exit code is 1 where one with an error
below a hundredth is doubted, or where a lie is believed at tolerances of 1e-6 or tighter.
"""

from __future__ import annotations

import sys
import warnings
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import click
import numpy as np

from hhtbench import Problem, Request, Solution, Status
from hhtbench.campaign.accuracy import compare
from hhtbench.campaign.reference.plan import registered_plans, validated_spec
from hhtbench.catalogue.registry import list_problems, load_problem, load_solver
from hhtbench.checks.result.judge import Judgement, judge
from hhtbench.solution.result import Ends, ends_of
from tests.trust.faulty import MOTIONS, Faulty

CONTROLLED = (
    *(
        "hht(alpha=-0.05)",
        "hht(alpha=-0.3)",
        "ida(form=ggl)",
        "ida(form=index1)",
        "ida(form=integrated)",
        "ida(form=index2)",
    ),
    *("ida(form=index3)", "cvode(form=ode, method=bdf)", "cvode(form=ode, method=adams)", "scipy(method=Radau)"),
    *("scipy(method=BDF)", "scipy(method=LSODA)", "scipy(method=DOP853)", "projected(method=DOP853)"),
    *("projected(method=RK23)", "collocation(form=ggl)"),
)
STEPPED = ("hht(alpha=-0.05)", "generalised_alpha", "hht_i3", "rattle")
RTOL = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
STEPS = (60, 200, 600, 2000)
ROWS = 51
MAX_SECONDS = 1.5  # of one solve


def settings() -> list[dict[str, Any]]:
    """Tolerances and numbers of steps, as a request takes them."""
    return [{"rtol": rtol} for rtol in RTOL] + [{"steps": steps} for steps in STEPS]


def honest(problem: Problem) -> Iterator[tuple[str, dict[str, Any], Judgement, float | None]]:
    """Solver, setting, judgement and largest scaled error of q of every solve that is reported as a success."""
    for solvers, asked in ((CONTROLLED, "rtol"), (STEPPED, "steps")):
        for name in solvers:
            for setting in (one for one in settings() if asked in one):
                made = _solved(
                    problem, name, Request(t_eval=np.linspace(*problem.t_span, ROWS), max_seconds=MAX_SECONDS, **setting)
                )
                if made is None:
                    continue
                solution, request = made
                found = compare(problem, solution)
                error = None if found is None or "q" not in found.got else float(np.max(found.scaled("q")))
                yield name, setting, judge(problem, request, solution), error


def _solved(problem: Problem, name: str, request: Request) -> tuple[Solution, Request] | None:
    """A success with its steps, where the solver makes one."""
    solver = load_solver(name)
    if solver.accepts(problem, request) is not None:
        return None
    solution = solver.solve(problem, replace(request, keep_steps=True))
    if solution.status is not Status.success:
        return None
    ends = ends_of(solution)
    if ends is None:
        every = solver.solve(problem, replace(request, t_eval=None))
        ends = Ends(t=every.t, q=every.q, v=every.v) if every.status is Status.success else None
    return solution.but(ends=ends), request


def lies(problem: Problem) -> Iterator[tuple[str, dict[str, Any], Judgement]]:
    """Motion, setting and judgement of every liar."""
    t = np.linspace(*problem.t_span, ROWS)
    for motion in MOTIONS:
        rows = Faulty(motion).solve(problem, Request(rtol=1e-3, t_eval=t))
        every = Faulty(motion).solve(problem, Request(rtol=1e-3))
        rows = replace(rows, ends=Ends(t=every.t, q=every.q, v=every.v))
        for setting in settings():
            yield motion, setting, judge(problem, Request(t_eval=t, **setting), rows)


def show(title: str, table: dict[str, dict[str, Counter[str]]], heads: list[str]) -> None:
    """Rows of ``found/all (not judged)``."""
    click.echo(f"\n{title}\n\n| | {' | '.join(heads)} |\n|---|{'---|' * len(heads)}")
    for name, cells in table.items():
        texts = [
            f"{cells[head]['doubted']}/{cells[head].total()}"
            + (f" ({cells[head]['blunt']})" if cells[head]["blunt"] else "")
            for head in heads
        ]
        click.echo(f"| {name} | {' | '.join(texts)} |")


def outcome(judgement: Judgement) -> str:
    """``doubted``, ``blunt`` where the motion could not be judged, or ``believed``."""
    return "doubted" if judgement.doubt else "blunt" if judgement.not_judged else "believed"


def heading(setting: dict[str, Any]) -> str:
    """``rtol 0.01`` or ``60 steps``."""
    return f"rtol {setting['rtol']:g}" if "rtol" in setting else f"{setting['steps']} steps"


def main(words: list[str]) -> int:
    """Measure, print, and say whether a lie at rtol 1e-6 or an honest solve with a small error is misjudged."""
    warnings.simplefilter("ignore")
    only = words[words.index("--only") + 1] if "--only" in words else ""
    names = [word for word in words if not word.startswith("--") and word != only] or list_problems()
    plan, wrong = registered_plans(), 0
    false: dict[str, dict[str, Counter[str]]] = defaultdict(lambda: defaultdict(Counter))
    found: dict[str, dict[str, Counter[str]]] = defaultdict(lambda: defaultdict(Counter))
    for name in names:
        problem = load_problem(validated_spec(name, plan))
        if only != "lies":
            for solver, setting, judgement, error in honest(problem):
                false[solver][heading(setting)][outcome(judgement)] += 1
                if judgement.doubt:
                    small = error is not None and error < 0.01
                    wrong += small
                    word = "FALSE" if small else "doubted"
                    click.echo(f"{word}: {name}, {solver}, {heading(setting)}: error {error}; {judgement.doubt}")
        if only != "honest":
            for motion, setting, judgement in lies(problem):
                found[motion][heading(setting)][outcome(judgement)] += 1
                if not judgement.doubt and setting.get("rtol", 1.0) <= 1e-6:
                    wrong += 1
                    click.echo(f"MISSED: {name}, {motion}, {heading(setting)} {judgement.not_judged}")
        click.echo(f"{name} done", err=True)
    heads = [heading(setting) for setting in settings()]
    if false:
        show("Honest solves that are doubted, of all (not judged)", false, heads)
    if found:
        show("Lies that are found, of all (not judged)", found, heads)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
