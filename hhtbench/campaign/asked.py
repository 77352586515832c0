"""Make a campaign from a command's options or from arguments in Python."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from hhtbench.campaign.files import named_campaign
from hhtbench.campaign.plan import Campaign, Grid, restrict
from hhtbench.catalogue import plugins
from hhtbench.catalogue.registry import load_solver
from hhtbench.catalogue.specs import parse_spec
from hhtbench.protocol.arguments import real_number
from hhtbench.protocol.errors import ProblemError

KINDS = {"rtol": float, "step": float, "steps": int}  # options of a command that take lists of numbers


def campaign_of(
    problems: tuple[str, ...], solvers: tuple[str, ...], campaign: str | Campaign | None, fields: Mapping[str, Any]
) -> Campaign:
    """Restrict ``campaign`` to these problems and solvers, or make a new one; ``fields`` are those of Campaign and Grid.

    Raises
    ------
    ProblemError, TypeError
        They contradict each other, or no field has such a name.
    """
    of_campaign = {name: value for name, value in fields.items() if name in Campaign.__dataclass_fields__}
    of_grid = {name: value for name, value in fields.items() if name in Grid.__dataclass_fields__}
    unknown = sorted(set(fields) - set(of_campaign) - set(of_grid))
    if unknown:
        known = sorted({*Campaign.__dataclass_fields__, *Grid.__dataclass_fields__} - {"grids", "problems", "solvers"})
        raise TypeError(f"run does not know {', '.join(unknown)}; known: {', '.join(known)}.")
    if of_grid and "accuracies" in of_campaign:
        raise ProblemError(f"accuracies and {', '.join(of_grid)} exclude one another; give one of them.")
    given = of_campaign.get("accuracies", (0.5,))
    if not given or not all(0.0 < real_number("accuracies", value) < 1.0 for value in given):
        raise ProblemError(f"accuracies must be errors between 0 and 1, at least one; got {list(given)}.")
    if campaign is None:
        return Campaign(grids=(Grid(problems=problems, solvers=solvers, **of_grid),), **of_campaign)
    if of_grid:
        raise ProblemError(f"a campaign has its own {', '.join(of_grid)}; leave them out.")
    found = named_campaign(campaign) if isinstance(campaign, str) else campaign
    return replace(restrict(found, problems, solvers), **of_campaign)


def asked_campaign(name: str | None, problems: tuple[str, ...], solvers: tuple[str, ...], **options: Any) -> Campaign:
    """Make the campaign of the options of ``hhtbench run`` and ``status``.

    Raises
    ------
    ProblemError, TypeError
        The options contradict each other; what :func:`refuse_misspelt` raises.
    """
    fields = {
        key: _numbers(key, value) if key in KINDS else value for key, value in options.items() if value not in (None, ())
    }
    campaign = campaign_of(tuple(split_specs(problems)), tuple(split_specs(solvers)), name, fields)
    refuse_misspelt(tuple(solver for grid in campaign.grids for solver in grid.solvers))
    return campaign


def refuse_misspelt(solvers: tuple[str, ...]) -> None:
    """Make every registered solver once before anything runs, so that a wrong option is an error and not a failed cell.

    Files are not executed here.  A solver that cannot be imported, or fails otherwise, costs its own cells only.

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
    """Split texts into specs at the commas outside of brackets and quotes."""
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


def _numbers(name: str, texts: tuple[str, ...]) -> tuple[Any, ...]:
    words = [word for text in texts for word in re.split(r"[,\s]+", text) if word]
    try:
        return tuple(map(KINDS[name], words))
    except ValueError as error:
        raise ProblemError(f"--{name} takes numbers separated by commas; got {', '.join(words)}.") from error
