"""The readings of a whole mechanism as columns by name."""

from __future__ import annotations

import itertools
from typing import Any

from hhtbench.mechanics.multibody.motion import SLIDING, TURNING
from hhtbench.mechanics.multibody.readings import (
    BodyReading,
    CoordinateReading,
    ElementReading,
    JointReading,
    Reading,
    SignalReading,
)


def tabulated(m: Any, solution: Any) -> dict[str, Any]:
    """Columns by name, see ``Mechanism.table``."""
    found: dict[str, Any] = {"t": Reading(m, solution, "mechanism").t}
    for name in m.bodies:
        body = BodyReading(m, solution, name)
        found |= _columns(name, body.position())
        found |= _columns(f"{name}.velocity", body.velocity()) | _columns(f"{name}.rate", body.rate())
    for name, joint in m.joints.items():
        if joint.measured is not None:
            found |= _of_coordinate(name, joint, CoordinateReading(m, solution, joint))
        else:
            found |= _of_joint(name, joint, JointReading(m, solution, joint))
    for name, element in m.forces.items():
        if element.kind not in ("load", "swivel"):
            found |= _of_element(m, name, element.kind, ElementReading(m, solution, element))
    for name in m.signals:
        found |= _columns(name, SignalReading(m, solution, name).value(), itertools.count())
    return found


def _columns(name: str, values: Any, components: Any = "xyz") -> dict[str, Any]:
    """Column ``name`` of ``values`` (k,), or one for each component of ``values`` (k, d)."""
    if values.ndim == 1:
        return {name: values}
    return {f"{name}.{axis}": column for axis, column in zip(components, values.T, strict=False)}


def _of_coordinate(name: str, joint: Any, reading: CoordinateReading) -> dict[str, Any]:
    """Columns of one joint of a composite."""
    kind = "travel" if joint.kind == "slide" else "angle"
    return {f"{name}.{kind}": getattr(reading, kind)(), f"{name}.rate": reading.rate()}


def _of_joint(name: str, joint: Any, reading: JointReading) -> dict[str, Any]:
    found: dict[str, Any] = {}
    if joint.base in TURNING:
        found[f"{name}.angle"] = reading.angle()
    if joint.base in SLIDING:
        found[f"{name}.travel"] = reading.travel()
    if joint.base in TURNING + SLIDING:
        found[f"{name}.rate"] = reading.rate()
    if joint.kind == "motor":
        found[f"{name}.power"] = reading.power()
    return found | _columns(f"{name}.force", reading.force()) | _columns(f"{name}.torque", reading.torque())


def _of_element(m: Any, name: str, kind: str, reading: ElementReading) -> dict[str, Any]:
    of_bushing = ("x", "y", "turn.z") if m.plane else ("x", "y", "z", "turn.x", "turn.y", "turn.z")
    found = _columns(f"{name}.measure", reading.measure(), of_bushing)
    found |= _columns(f"{name}.rate", reading.rate(), of_bushing) | _columns(
        f"{name}.tension", reading.tension(), of_bushing
    )
    if kind in ("contact", "ball", "tyre"):
        found |= _columns(f"{name}.friction", reading.friction())
    if kind == "tyre":
        found |= _columns(f"{name}.slip", reading.slip(), ("along", "across"))
    return found
