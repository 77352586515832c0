"""Plots of one solution over time with Matplotlib."""

from __future__ import annotations

from typing import Any

import numpy as np

MOST_LINES = 24  # of one panel; the rest is not drawn, and the panel says so
MOST_NAMED = 8  # lines of a panel with a legend
WIDTH, HEIGHT = 8.0, 2.0  # of one panel [in]
UNITS = {"q": "q [m, rad]", "v": "v [m/s, rad/s]", "lam": "multipliers lam", "mu": "multipliers mu"}

Lines = dict[str, tuple[Any, Any]]  # name -> t (k,) and values (k,)


def plot_solution(solution: Any, drift: Any = None) -> Any:
    """Return a figure with one panel each for q, v, lam and mu, and logarithmic panels for estimated error and ``drift``."""
    import matplotlib.pyplot as plt

    if not np.size(solution.t):
        raise ValueError(f"there is nothing to plot, the solution has no rows: {solution.status.label}: {solution.message}")
    panels: list[tuple[str, Lines, bool]] = [(unit, _columns(solution, name), False) for name, unit in UNITS.items()]
    if solution.error is not None:
        estimates = {name: (solution.t, getattr(solution.error, name)) for name in ("q", "v")}
        panels.append(("estimated error / scale", estimates, True))
    if drift is not None:
        panels.append((f"drift / scale at {drift.sampled}", _drifts(drift), True))
    shown = [panel for panel in panels if panel[1]]
    figure, axes = plt.subplots(
        len(shown), 1, sharex=True, squeeze=False, figsize=(WIDTH, HEIGHT * len(shown)), layout="constrained"
    )
    for axis, (label, lines, logarithmic) in zip(axes[:, 0], shown, strict=True):
        _draw(axis, label, lines, logarithmic)
    axes[-1, 0].set_xlabel("t [s]")
    figure.suptitle(f"{solution.status.label}, {np.size(solution.t)} rows", fontsize=10)
    return figure


def _columns(solution: Any, name: str) -> Lines:
    values = getattr(solution, name)
    return {f"{name}[{i}]": (solution.t, values[:, i]) for i in range(values.shape[1])}


def _drifts(drift: Any) -> Lines:
    """Return the curves of a :class:`hhtbench.checks.drift.Drift` by name, without those that are None."""
    curves = {"position": drift.position, "velocity": drift.velocity, "energy": drift.energy, **drift.invariants}
    return {name: (drift.t, values) for name, values in curves.items() if values is not None}


def _draw(axis: Any, label: str, lines: Lines, logarithmic: bool) -> None:
    drawn = list(lines.items())[:MOST_LINES]
    for name, (t, values) in drawn:
        shown = np.where(values != 0, np.abs(values), np.nan) if logarithmic else values  # a zero has no logarithm
        axis.plot(t, shown, ".-" if logarithmic else "-", label=name, linewidth=1.2, markersize=2)
    if logarithmic:
        axis.set_yscale("log")
    axis.set_ylabel(label, fontsize=9)
    axis.grid(alpha=0.3)
    if len(lines) > len(drawn):
        axis.set_title(f"the first {len(drawn)} of {len(lines)}", fontsize=8, loc="right")
    if len(drawn) <= MOST_NAMED:
        axis.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
