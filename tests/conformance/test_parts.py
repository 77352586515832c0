"""Absent parts cost nothing, reductions do not change the answer, and the study says so where one does."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from hhtbench.cli.main import main
from hhtbench.conformance.parts import measure, study
from hhtbench.conformance.parts.measure import Cost, counted, height, left_by, memory_of, operations_of, own, python_of, run
from hhtbench.conformance.parts.scenes import FREE, Scene
from hhtbench.conformance.parts.study import PARTS, REDUCTIONS, SPHERE, SPRING, Gain, PartCost, Study, difference, line_of
from hhtbench.lowering import REDUCTIONS as SWITCHES
from hhtbench.protocol.errors import ProblemError
from solvers.kernel import memory as mem

NAMED = {x.name: x for x in PARTS}
EMPTY = {  # sections of the loops' memory, by the part whose absence leaves them without a place
    "g": (mem.LAM, mem.LEVELS, mem.ROW_SIZES),
    "k": (mem.MU, mem.LEVELS, mem.ROW_SIZES),
    "mass, variable": (mem.INVERSE_MASS, mem.END_INVERSE_MASS),
    "events": (mem.EVENT_VALUES, mem.SAMPLE_TIMES, mem.SAMPLE_VALUES),
}
COST = Cost(calls={"force": 3.0}, once={"force": 2.0}, seconds=1e-6, memory=100, operations=50, python=0.0, left=0.0)
FULL = replace(COST, operations=60, memory=200)
GAIN = Gain(reduction=REDUCTIONS[0], seconds=1e-6, seconds_without=2e-6, difference=1e-15, line="M: factorised once")


@pytest.mark.parametrize("scene", [SPRING, NAMED["energy"].present], ids=["force alone", "with what is only measured"])
def test_a_scene_of_a_force_calls_nothing_else(scene):
    assert counted(scene, 3).keys() == {"force", "force_jacobians"}


def test_of_a_pendulum_no_part_is_called_that_it_has_not():
    calls = counted(SPHERE, 3)
    absent = {"mass, constant", "k", "events", "energy"}
    assert {name: calls[name] for part in absent for name in NAMED[part].terms if calls[name]} == {}
    assert calls["constraint"] > 0


@pytest.mark.parametrize("name", EMPTY)
def test_a_part_that_is_there_is_called_and_one_that_is_absent_has_no_place_in_the_memory(name):
    def lengths(scene):
        hht = scene.integrator(height)
        hht.init_step(0.0, scene.q0, scene.v0, step=0.01)
        return [mem.view(hht._engine.loops.z, section).size for section in EMPTY[name]]

    part = NAMED[name]
    assert own(counted(part.present, 3), part.terms) > 0
    assert lengths(part.absent) == [0] * len(EMPTY[name])
    assert all(lengths(part.present))
    assert memory_of(part.absent) < memory_of(part.present)


@pytest.mark.parametrize("reduction", REDUCTIONS, ids=lambda x: x.name)
def test_without_a_reduction_the_answer_is_the_same_and_describe_names_the_switch(reduction):
    assert difference(reduction) <= study.SAME
    assert line_of(reduction)


OF_CODE = [x for x in REDUCTIONS if x.name != "linear reaction"]


@pytest.mark.parametrize("reduction", OF_CODE, ids=lambda x: x.name)
def test_a_switch_changes_code_or_the_kind_of_matrix(reduction):
    def made(**options):
        hht = reduction.scene.integrator(height, **options)
        hht.init_step(0.0, reduction.scene.q0, reduction.scene.v0, step=0.01)
        functions = hht._engine.functions
        operations = {name: code.operations for name, code in functions._codes.items()}
        return hht._engine.why, operations, functions.analysis.rows.size

    assert made() != made(**reduction.option)


def test_without_a_linear_reaction_multipliers_are_iterated_for():
    reduction = next(x for x in REDUCTIONS if x not in OF_CODE)
    once, iterated = (counted(replace(reduction.scene, options=x), 3) for x in ({}, reduction.option))
    assert iterated["constraint_acceleration"] > once["constraint_acceleration"]


def test_every_reduction_that_is_read_off_a_system_is_measured():
    assert {x.option["without"] for x in REDUCTIONS if "without" in x.option} == set(SWITCHES)


def part(name, absent=COST, present=FULL):
    return PartCost(part=NAMED[name], absent=absent, present=present)


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (part("g"), ""),
        (part("g", replace(COST, calls={"constraint": 2.0})), "g: 0 calls and 2 a step"),
        (part("k", replace(COST, once={"velocity_reaction": 1.0})), "k: 1 calls"),
        (part("force of v", FULL), "60 operations where it is absent, 60 where it is there"),
        (
            part("time in g", replace(COST, calls={"constraint": 3.0}), replace(FULL, calls={"constraint": 3.0})),
            "3 calls a step",
        ),
        (
            part("dense output", present=replace(COST, calls={"force": 4.0})),
            "dense output: it calls functions of the system",
        ),
        (part("energy", replace(COST, python=0.5)), "0.5 calls in Python a step"),
        (part("energy", replace(COST, left=40.0)), "40 bytes left behind"),
        (part("events", present=COST), "100 bytes of the loop's arrays where it is absent, 100 where"),
        (GAIN, ""),
        (replace(GAIN, difference=2e-12), "the answer differs by 2.0e-12"),
        (replace(GAIN, difference=np.nan), "the answer differs by nan"),
        (replace(GAIN, line=""), "describe does not name it"),
    ],
)
def test_the_study_says_what_does_not_hold(found, words):
    assert words in found.fault
    assert bool(found.fault) == bool(words)
    made = Study(parts=(found,)) if isinstance(found, PartCost) else Study(gains=(found,))
    assert made.faults == ((found.fault,) if words else ())
    assert found.fault in str(made)


def test_the_command_prints_both_tables_and_writes_them(monkeypatch, tmp_path):
    monkeypatch.setattr(measure, "TIMED", 20)
    monkeypatch.setattr(study, "PARTS", (NAMED["events"],))
    monkeypatch.setattr(study, "REDUCTIONS", (REDUCTIONS[-1],))
    file = tmp_path / "parts.json"
    done = CliRunner().invoke(main, ["study", "parts", "--rounds", "1", "--json", str(file)])
    assert done.exit_code == 0, done.output
    written = json.loads(file.read_text())
    assert written["parts"][0]["absent"]["calls"].get("event", 0.0) == 0.0
    assert written["parts"][0]["present"]["calls"]["event"] > 0
    assert written["reductions"][0]["difference"] <= study.SAME
    assert all(name in done.output for name in ("events", "kept inverse of few unknowns", "linsolver=dense"))


def test_a_run_that_ends_early_is_not_measured():
    with pytest.raises(ProblemError, match="inconsistent_initial"):
        run(replace(SPHERE, q0=np.array([2.0, 0.0, 0.0])), 3)


@pytest.mark.parametrize("scene", [SPRING, SPHERE])
def test_steps_in_machine_code_call_nothing_in_python_and_leave_nothing_behind(scene):
    assert python_of(scene) == 0.0
    assert left_by(scene) <= study.ROUNDING


def test_calls_in_python_and_what_steps_leave_behind_are_seen():
    kept = []

    def hoarding(t, q, v):
        kept.append(np.zeros(8))
        return q[2] - 100.0

    scene = Scene(system=FREE, watched=True)
    given = {name: getattr(scene, name) for name in ("request", *(field.name for field in fields(Scene)))}
    made = SimpleNamespace(**given, integrator=lambda event, *rest, **options: scene.integrator(hoarding, *rest, **options))
    assert python_of(made) > 0.0
    assert left_by(made) > study.ROUNDING


@pytest.mark.parametrize("name", sorted(x.name for x in PARTS if x.longer))
def test_functions_of_a_step_are_longer_for_a_part_of_the_equations(name):
    assert operations_of(NAMED[name].absent) < operations_of(NAMED[name].present)


@pytest.mark.parametrize("name", ["time in g", "nonlinear reaction", "error control", "rows with multipliers"])
def test_a_part_adds_calls_of_functions_that_it_shares(name):
    few, many = (counted(getattr(NAMED[name], side), 6) for side in ("absent", "present"))
    assert own(few, NAMED[name].more) < own(many, NAMED[name].more)
