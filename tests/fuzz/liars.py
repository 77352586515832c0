"""Solvers that mislead: HHT, and what is done to what it is given or answers.  The fuzzing must find each."""

from __future__ import annotations

import numpy as np

from hhtbench import Status
from tests.fuzz.runs import hht


def telling(change):
    """A solver whose successes are changed; ``change`` receives the request too."""

    def lying(system, span, q0, v0, options, events, request):
        found = hht(system, span, q0, v0, options, events, request)
        return change(found, {**options, **request}) if found.success and found.t.size > 2 else found

    return lying


def deaf_to(name):
    """A solver that leaves out a part of the request."""

    def lying(system, span, q0, v0, options, events, request):
        return hht(system, span, q0, v0, options, events, {k: v for k, v in request.items() if k != name})

    return lying


def faster(part):
    """Of the last row, by that part: along the constraints, where nothing drives them."""

    def change(s, asked):
        v = s.v.copy()
        v[-1] *= 1.0 + part(s, asked)
        return s.but(v=v)

    return telling(change)


def beside(s, asked):
    """A millionth off its path."""
    q = s.q.copy()
    q[1:] *= 1.0 + 1e-6
    return s.but(q=q)


def powerless(s, asked):
    """Constraints that take up no force."""
    return s.but(lam=np.zeros_like(s.lam), mu=np.zeros_like(s.mu))


def early(s, asked):
    """Stops one row before the end, and says success."""
    return s.but(**{name: getattr(s, name)[:-1] for name in ("t", "q", "v", "lam", "mu")})


def empty(s, asked):
    """Not a number, and success."""
    q = s.q.copy()
    q[-1, 0] = np.nan
    return s.but(q=q)


def afraid(s, asked):
    """Never arrives."""
    return s.but(status=Status.newton_failed, message="did not converge")


def blind(s, asked):
    """Sees no event."""
    return s.but(**{name: tuple(x[:0] for x in getattr(s, name)) for name in ("t_events", "q_events", "v_events")})


def raising(*_):
    """Crashes."""
    raise ArithmeticError("lost")


LIARS = {  # with the family and the twin by which they are found
    "beside": (telling(beside), "steps", "none"),
    "powerless": (telling(powerless), "steps", "none"),
    "early": (telling(early), "control", "none"),
    "empty": (telling(empty), "hostile", "none"),
    "afraid": (telling(afraid), "steps", "none"),
    "raising": (raising, "hostile", "none"),
    "leaping": (faster(lambda s, asked: 0.05), "steps", "none"),
    "hasty": (faster(lambda s, asked: 0.1), "control", "none"),
    "of metres": (faster(lambda s, asked: 1e-5 * (np.abs(s.q).max() > 100.0)), "steps", "units"),
    "crooked": (faster(lambda s, asked: 1e-5 * s.q[-1, 0] / np.abs(s.q[-1]).max()), "steps", "rotated"),
    "of unit rows": (faster(lambda s, asked: 1e-3 * np.tanh(np.log(np.abs(s.lam).max(initial=1.0)))), "steps", "rescaled"),
    "irreversible": (faster(lambda s, asked: 1e-5), "steps", "reversed"),
    "full": (faster(lambda s, asked: 1e-6 * (asked.get("linsolver") == "sparse")), "steps", "algebra"),
    "of first order": (faster(lambda s, asked: 0.1 / s.t.size), "steps", "order"),
    "endless": (deaf_to("max_num_steps"), "steps", "budget"),
    "rowless": (deaf_to("t_eval"), "control", "rows"),
    "blind": (telling(blind), "control", "watched"),
    "interpreted": (faster(lambda s, asked: 1e-12 * (asked.get("engine") == "python")), "steps", "python"),
}
