"""Draw the pictures of this folder: README's, that of the first page, and the gallery's in small.

Run ``python docs/pictures/draw.py`` from the root of the repository; it takes a minute on an idle machine.
"""

import re
import runpy
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

import hhtbench as hb
from hhtbench.campaign import analysis

FOLDER = Path(__file__).parent
SOLVERS = {
    "hht(alpha=-0.05)": "HHT",
    "projected(method=DOP853)": "DOP853 with projection",
    "ida(form=ggl)": "IDA",
    "scipy(method=Radau)": "Radau",
}


def crane() -> hb.Problem:
    """The problem of README's first block."""
    block = re.search(r"```python\n(.*?)```", (FOLDER.parent.parent / "README.md").read_text(), re.DOTALL)
    scope: dict = {}
    exec(block[1], scope)  # type: ignore[index]
    return scope["crane"]


def draw_motion(axes, problem: hb.Problem) -> None:
    """The crane at six times, pale at first, on the path of its load."""
    times = np.linspace(*problem.t_span, 400)
    q = hb.solve(problem, rtol=1e-6, t_eval=times).q
    axes.plot(q[:, 1], q[:, 2], color="0.75", linewidth=1)
    for row, depth in zip(q[::79], np.linspace(0.2, 1.0, 6), strict=True):
        axes.plot(row[:2], [0, row[2]], color="C0", alpha=depth)
        axes.plot(row[0], 0, "s", color="0.3", alpha=depth, markersize=9)
        axes.plot(row[1], row[2], "o", color="C1", alpha=depth, markersize=7)
    axes.axhline(0, color="0.3", linewidth=1, zorder=0)
    axes.set(aspect="equal", title="A crane in 10 s", xlabel="x [m]", ylabel="y [m]")


def draw_decision(axes, problem: hb.Problem) -> None:
    """Error against processor time of every believed run of ``hb.trade``."""
    found = hb.trade(problem, accuracies=[1e-2, 1e-4, 1e-6], seconds=60, solvers=list(SOLVERS))
    for solver, label in SOLVERS.items():
        runs = [row for row in analysis.points(found.rows) if row.entry == solver and row.time and row.error]
        runs.sort(key=lambda run: run.error)
        axes.loglog([1e3 * run.time for run in runs], [run.error for run in runs], "o-", markersize=4, label=label)
    axes.set(title="Which solver reaches an error first?", xlabel="processor time [ms]", ylabel="error")
    axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    print(found.sentence)


problem = crane()  # worker processes find it by this name

if __name__ == "__main__":
    mpl.use("agg")
    for script in sorted((FOLDER.parent / "gallery").glob("plot_*.py")):
        runpy.run_path(str(script))
        plt.gcf().savefig(FOLDER / f"{script.stem[5:]}.png", dpi=45)
        plt.close("all")
    hb.solve(problem, rtol=1e-4).plot().savefig(FOLDER / "crane.png", dpi=70)
    figure, axes = plt.subplots(1, 2, figsize=(10, 3.2), layout="constrained")
    draw_motion(axes[0], problem)
    draw_decision(axes[1], problem)
    figure.savefig(FOLDER / "front.png", dpi=110)
