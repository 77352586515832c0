"""A campaign from the options of a command: specs, numbers, names."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any, Literal

from hhtbench import plugins
from hhtbench.campaign.files import named_campaign
from hhtbench.campaign.plan import Campaign, Grid, restrict
from hhtbench.errors import ProblemError
from hhtbench.registry import load_solver
from hhtbench.specs import parse_spec


def asked_campaign(
    name: str | None,
    problems: tuple[str, ...],
    solvers: tuple[str, ...],
    rtol: tuple[str, ...],
    step: tuple[str, ...],
    steps: tuple[str, ...],
    max_seconds: float | None,
    reference: Literal["none", "auto"] | None,
) -> Campaign:
    """The campaign of the options of ``hhtbench run`` and ``status``.

    Raises
    ------
    ProblemError, TypeError
        The options contradict each other; what :func:`refuse_misspelt` raises.
    """
    some = tuple(split_specs(problems)), tuple(split_specs(solvers))
    if name is None:
        grid = Grid(
            problems=some[0],
            solvers=some[1],
            rtol=_numbers("rtol", rtol, float),
            step=_numbers("step", step, float),
            steps=_numbers("steps", steps, int),
        )
        campaign = Campaign(grids=(grid,))
    elif rtol or step or steps:
        raise ProblemError(f"the campaign {name} has its own tolerances and steps; leave out --rtol, --step and --steps.")
    else:
        campaign = restrict(named_campaign(name), *some)
    refuse_misspelt(tuple(solver for grid in campaign.grids for solver in grid.solvers))
    changes: dict[str, Any] = {"max_seconds": max_seconds, "reference": reference}
    return replace(campaign, **{name: value for name, value in changes.items() if value is not None})


def refuse_misspelt(solvers: tuple[str, ...]) -> None:
    """Make every registered solver once, before anything runs: a wrong option is wrong use, not a row.

    Files are not executed here.  What cannot be imported, or fails otherwise, costs its own cells only.

    Raises
    ------
    ProblemError, TypeError
        There is no such solver, or it cannot be made with these options.
    """
    for text in split_specs(solvers):
        spec = parse_spec(text)
        if spec.path is not None:
            continue
        plugins.find("solver", spec.name)
        try:
            plugins.load("solver", spec.name)
        except ProblemError:  # its library is missing or broken
            continue
        try:
            load_solver(text)
        except (ProblemError, TypeError):
            raise
        except Exception:  # noqa: BLE001 - the plugin's own: the workers tell
            continue


def split_specs(texts: tuple[str, ...]) -> list[str]:
    """Specs separated by commas that are outside of brackets and quotes."""
    found = []
    for text in texts:
        depth, quote, start = 0, "", 0
        for i, character in enumerate(text):
            if quote:
                quote = "" if character == quote else quote
            elif character in "'\"" and depth:
                quote = character
            elif character in "([":
                depth += 1
            elif character in ")]":
                depth -= 1
            elif character == "," and depth == 0:
                found.append(text[start:i])
                start = i + 1
        found.append(text[start:])
    return [text.strip() for text in found if text.strip()]


def _numbers(name: str, texts: tuple[str, ...], kind: Any) -> tuple[Any, ...]:
    words = [word for text in texts for word in re.split(r"[,\s]+", text) if word]
    try:
        return tuple(kind(word) for word in words)
    except ValueError as error:
        raise ProblemError(f"--{name} takes numbers separated by commas; got {', '.join(words)}.") from error
