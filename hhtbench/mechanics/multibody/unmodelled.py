"""What a file has and a mechanism has not: it is named and refused, or dropped."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhtbench.mechanics.multibody.controls import unmodelled_reason
from hhtbench.protocol.errors import ProblemError, did_you_mean

SHOWN = 5  # names in a message


def expect_modelled(file: Any, path: str, drop: Any) -> None:
    """Raise an error that names the elements that are not modelled, unless ``drop`` has their kind or is True."""
    found = {kind: names for kind, names in _found(file).items() if names}
    if drop is True:
        return
    dropped = [drop] if isinstance(drop, str) else list(drop or ())
    for kind in dropped:
        if kind not in KINDS:
            raise ProblemError(f"drop: there is no kind {kind!r}.{did_you_mean(kind, KINDS)} Kinds: {', '.join(KINDS)}.")
    left = {kind: names for kind, names in found.items() if kind not in dropped}
    if left:
        text = "; ".join(f"{kind} ({_listed(names)})" for kind, names in left.items())
        kinds = ", ".join(repr(kind) for kind in [*dropped, *left])
        raise ProblemError(f"not modelled: {text}. Type drop=[{kinds}] to leave them out, drop=True to leave out all such.")


KINDS = (
    "contacts",
    "limits",
    "frictionloss",
    "actuators",
    "tendons",
    "equalities",
    "force ranges",
    "polynomials",
    "plasticity",
    "gravity compensation",
    "fluid",
    "flexible bodies",
    "moving frames",
    "plugins",
)


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + more


def _found(file: Any) -> dict[str, list[str]]:
    model, name = file.model, file.name
    joints, free = range(model.njnt), not file.off("constraint")
    ranged = model.jnt_limited if free and not file.off("limit") else np.zeros(model.njnt, bool)
    rubbing = free and not file.off("frictionloss")
    reasons = {} if file.off("actuation") else {i: unmodelled_reason(file, i) for i in range(model.nactuator)}
    polynomial = [
        abs(model.jnt_stiffnesspoly[j]).any() or abs(model.dof_dampingpoly[model.jnt_dofadr[j]]).any() for j in joints
    ]
    driven = set() if file.off("actuation") else {int(x) for x in model.actuator_trnid[:, 0]}
    kinds = file.mujoco.mjtEq
    known = [int(kinds.mjEQ_CONNECT), int(kinds.mjEQ_WELD), int(kinds.mjEQ_JOINT)]
    equal = [i for i in np.flatnonzero(model.eq_active0) if model.eq_type[i] not in known]
    return {
        "contacts": _contacts(file) if free and not file.off("contact") else [],
        "limits": [name("joint", j) for j in joints if ranged[j]],
        "frictionloss": [name("joint", j) for j in joints if rubbing and file.dof("dof_frictionloss", j)],
        "actuators": [f"{name('actuator', i)} {reason}" for i, reason in reasons.items() if reason],
        "tendons": [name("tendon", i) for i in range(model.ntendon)],
        "equalities": [] if file.off("equality") or not free else [name("equality", int(i)) for i in equal],
        "force ranges": [name("joint", j) for j in joints if model.jnt_actfrclimited[j] and j in driven],
        "polynomials": [name("joint", j) for j in joints if polynomial[j]],
        "plasticity": [name("joint", j) for j in joints if model.jnt_plasticadr[j] >= 0],
        "gravity compensation": [name("body", i) for i in range(model.nbody) if model.body_gravcomp[i]],
        "fluid": ["density or viscosity"] if model.opt.density or model.opt.viscosity else [],
        "flexible bodies": [name("flex", i) for i in range(model.nflex)],
        "moving frames": [name("body", i) for i in range(model.nbody) if model.body_mocapid[i] >= 0],
        "plugins": ["plugins"] if model.nplugin else [],
    }


def _contacts(file: Any) -> list[str]:
    """Geoms that can touch others: those that MuJoCo's filters of pairs leave."""
    model = file.model
    weld = model.body_weldid[model.geom_bodyid]
    above = model.body_weldid[model.body_parentid[weld]]
    types, affinities = model.geom_contype, model.geom_conaffinity
    touch = (types[:, None] & affinities) | (affinities[:, None] & types)
    parent = (above[:, None] == weld) & (weld != 0)
    can = (touch != 0) & (weld[:, None] != weld) & ~(parent | parent.T)
    pairs = np.concatenate([model.pair_geom1, model.pair_geom2]) if model.npair else np.zeros(0, int)
    return [file.name("geom", int(i)) for i in sorted({*np.flatnonzero(can.any(axis=1)), *pairs})]
