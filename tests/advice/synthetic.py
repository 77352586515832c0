"""Databases whose winners are known: on quick scenes ``swift`` is the cheapest, on stiff ones ``steady``."""

from __future__ import annotations

import numpy as np

from hhtbench.advice.database import ACCURACIES, HELD, Database, Scene
from hhtbench.advice.features import Features
from hhtbench.campaign.analysis.fronts import MEASURES
from hhtbench.campaign.machine import clock_of, machine_facts

ENTRIES = ("ida(form=ggl)", "scipy(method=DOP853)", "scipy(method=Radau)", "swift", "steady")


def features(vibration, size=0.5, pace=0.0):
    return Features(
        size=size,
        position=0.5,
        velocity=0.0,
        redundant=0.0,
        variable_mass=0.0,
        vibration=vibration,
        decay=pace,
        pace=pace,
        share=0.0,
    )


def scene(family, number, vibration, ratio=8.0):
    """``swift`` costs ``ratio`` times as much as ``steady`` where a vibration turns 100 times, else the reverse."""
    swift, steady = (ratio, 1.0) if vibration >= 2.0 else (1.0, ratio)
    row = np.array([20.0, 20.0, 20.0, swift, steady])
    costs = np.outer(row, 1e-3 * np.array(ACCURACIES) ** -0.2)
    table = {(measure, bound): costs * (1.0 if measure == "time" else 1e5) for measure in MEASURES for bound in HELD}
    return Scene(f"{family}(k={number})", features(vibration), table, 10, 1e-6)


def database(families=8, each=3, **changes):
    """Half of the families stiff."""
    scenes = tuple(scene(f"family{i}", j, 0.5 + 2.0 * (i % 2)) for i in range(families) for j in range(each))
    facts = machine_facts()
    values = {
        "entries": ENTRIES,
        "scenes": scenes,
        "clock": clock_of(facts),
        "versions": {"numpy": facts["numpy"]},
        "budget": 2.0,
    }
    return Database(**values | changes)
