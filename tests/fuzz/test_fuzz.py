"""Some fifty random mechanisms show no fault, and solvers that mislead are found; ``make fuzz`` draws 10,000."""

from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.fuzz.cases import World, cases, drawn
from tests.fuzz.explore import explore
from tests.fuzz.liars import LIARS
from tests.fuzz.mechanism import PARAMETERS, Mechanism, Shape
from tests.fuzz.oracles import energies
from tests.fuzz.runs import Setting
from tests.fuzz.second import slips

CASES = {"steps": 40, "control": 24, "machine": 12, "hostile": 44}
SEED = 20_260
LIES = 60  # cases within which one is found
WORLD = World(
    kinds=(
        Shape(dim=2, points=2, anchors=2, rods=((0, 2), (1, 0), (1, 3))),
        Shape(dim=2, points=2, rods=((0, 2), (1, 0)), blade=(1, 0), driven=True, growing=True),
    ),
    methods=({"alpha": 0.0, "b": 0.0}, {"alpha": -0.3, "b": 0.25}),
)


@pytest.mark.parametrize("family", CASES)
def test_no_random_case_shows_a_fault(family):
    """Sound and gentle ones arrive, and they are many."""
    found = explore(family, SEED, CASES[family], world=WORLD)
    told = [f"{fault}\npython -m tests.fuzz --case {case!r}" for fault, case in found.faults]
    assert not told, "\n".join(told)
    assert found.sound >= (0 if family == "hostile" else 0.4 * found.cases)
    assert found.ends["success"] >= 0.2 * found.cases


@pytest.mark.parametrize("name", LIARS)
def test_a_solver_that_misleads_is_found(name):
    solver, family, twin = LIARS[name]
    assert explore(family, SEED, LIES, solver, world=WORLD, stop=True, twin=twin).faults


def hanging(v):
    """Two kilograms on a rod of half a metre, slowed by 0.3 of its tension from 0.1 m/s on, at rest or not."""
    given = {"places": [[0.0, -0.5]], "velocities": [[v, 0.0]], "anchor": [[0.0, 0.0]], "gravity": [0.0, -10.0]}
    given |= {"mass": [2.0], "scale": [7.0], "length": [0.5], "friction": 0.3, "creep": 0.1}
    none = dict.fromkeys(PARAMETERS, 0.0) | {name: [] for name in ("stiffness", "natural", "damper")}
    shape = Shape(dim=2, points=1, anchors=1, rods=((0, 1),), reaction="friction")
    return Mechanism(shape, none | given)


@pytest.mark.parametrize(("v", "rate"), [(0.0, 0.3 * 10.0 / 0.1), (0.1, 0.3 * (10.0 + 0.02) / 0.1 / np.sqrt(2.0))])
def test_slips_grow_back_in_time_by_the_tension_over_the_speed_of_creep(v, rate):
    """Along the speed they grow by half of what they do across it, at that of creep."""
    judge = Setting(replace(drawn(cases("steps", WORLD), SEED), made=hanging(v))).judge
    assert judge.slipping(0.0, *judge.start[:2]) == pytest.approx(rate, rel=1e-12)


@pytest.mark.parametrize(("h", "told"), [(-0.03, False), (-0.04, True), (0.04, False)])
def test_steps_back_in_time_that_are_longer_are_not_judged(h, told):
    setting = Setting(replace(drawn(cases("steps", WORLD), SEED), made=hanging(0.0)))
    rows = np.array([[0.0, -0.5], [0.0, -0.5]])
    assert slips(setting, SimpleNamespace(t=np.array([0.0, h]), q=rows, v=0.0 * rows)) is told


@pytest.mark.parametrize(("alpha", "told"), [(0.0, {1.1, 0.9}), (-0.3, {1.1})])
def test_energy_is_kept_at_alpha_0_and_may_fall_but_not_grow_below(alpha, told):
    """Of conservative motions whose last velocities are changed."""
    settings, found = [], set()
    for number in range(SEED, SEED + 40):
        case = drawn(cases("steps", WORLD), number)
        options = {**case.way.options, "alpha": alpha}
        setting = Setting(replace(case, way=replace(case.way, options=options, watch="", ratios=())))
        if setting.judge.conserves and setting.judge.sound:
            settings.append(setting)
    assert len(settings) > 5
    for setting in settings:
        s = setting.base.solution
        energies(setting, s)
        for change in (1.1, 0.9):
            v = np.concatenate([s.v[:-1], change * s.v[-1:]])
            with suppress(AssertionError):
                energies(setting, s.but(v=v))
                continue
            found.add(change)
    assert found == told
