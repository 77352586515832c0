"""Solvers that mislead: HHT, and what is done to what it is given or answers.  The fuzzing must find each."""

from __future__ import annotations

import numpy as np

from hhtbench import Status
from tests.fuzz.runs import hht

MOTION, EVENTS = ("t", "q", "v", "lam", "mu"), ("t_events", "q_events", "v_events")


def telling(change):
    """A solver whose successes are changed; ``change`` receives the request too."""

    def lying(system, span, q0, v0, options, events, request):
        found = hht(system, span, q0, v0, options, events, request)
        return found.but(**change(found, {**options, **request})) if found.success and found.t.size > 2 else found

    return lying


def deaf_to(name):
    """A solver that leaves out a part of the request."""
    return lambda *given: hht(*given[:-1], {key: value for key, value in given[-1].items() if key != name})


def ending(name, change):
    """``name`` of the last row changed."""

    def changed(s, asked):
        rows = getattr(s, name).copy()
        rows[-1] = change(rows[-1], s, asked)
        return {name: rows}

    return telling(changed)


def faster(part):
    """Of the last row, by that part: along the constraints, where nothing drives them."""
    return ending("v", lambda v, s, asked: v * (1.0 + part(s, asked)))


def raising(*_):
    """Crashes."""
    raise ArithmeticError("lost")


LIARS = {  # with the family and the twin by which they are found
    "beside": (ending("q", lambda q, s, asked: q * (1.0 + 1e-6)), "steps", "none"),
    "powerless": (telling(lambda s, asked: {"lam": 0.0 * s.lam, "mu": 0.0 * s.mu}), "steps", "none"),
    "early": (telling(lambda s, asked: {name: getattr(s, name)[:-1] for name in MOTION}), "control", "none"),
    "adrift": (faster(lambda s, asked: 0.01), "hostile", "none"),
    "empty": (ending("q", lambda q, s, asked: np.nan), "hostile", "none"),
    "afraid": (telling(lambda s, asked: {"status": Status.newton_failed, "message": "did not converge"}), "steps", "none"),
    "raising": (raising, "hostile", "none"),
    "leaping": (faster(lambda s, asked: 0.05), "steps", "none"),
    "hasty": (faster(lambda s, asked: 0.1), "control", "none"),
    "of metres": (faster(lambda s, asked: 1e-5 * (np.abs(s.q).max() > 100.0)), "steps", "elsewhere"),
    "crooked": (faster(lambda s, asked: 1e-5 * s.q[-1, 0] / np.abs(s.q[-1]).max()), "steps", "elsewhere"),
    "of unit rows": (faster(lambda s, asked: 1e-3 * np.tanh(np.log(np.abs(s.lam).max(initial=1.0)))), "steps", "elsewhere"),
    "irreversible": (faster(lambda s, asked: 1e-5), "steps", "backward"),
    "full": (faster(lambda s, asked: 1e-6 * (asked.get("linsolver") == "sparse")), "steps", "algebra"),
    "of first order": (faster(lambda s, asked: 0.1 / s.t.size), "steps", "order"),
    "endless": (deaf_to("max_num_steps"), "steps", "budget"),
    "rowless": (deaf_to("t_eval"), "control", "rows"),
    "blind": (telling(lambda s, asked: {n: tuple(x[:0] for x in getattr(s, n)) for n in EVENTS}), "control", "watched"),
    "interpreted": (faster(lambda s, asked: 1e-12 * (asked.get("engine") == "python")), "steps", "python"),
}
