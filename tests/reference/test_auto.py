"""Certificates of scenes that nobody knows the truth of: stiff ones, and those whose prescribed velocities jump."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hhtbench.campaign.reference import certify, reference_of
from hhtbench.campaign.reference.auto import CVODE, EXPLICIT, GGL, INDEX1, certify_one, methods_for
from hhtbench.campaign.reference.files import read_certificate
from hhtbench.campaign.reference.plan import Entry
from hhtbench.catalogue.registry import load_problem

SCENES = Path(__file__).with_name("mechanisms.py")
STIFF = f"{SCENES}:bushings(n=3, k=1e9, c=1e6, t_end=0.3)"
CHAIN = f"{SCENES}:bushings(n=30, k=1e6, c=1e2, t_end=0.1)"


def test_who_is_tried_first_depends_on_constraints_and_on_modes_that_decay():
    """Without constraints there is no ggl; at 4e6 decays a second an explicit method takes a million steps."""
    assert methods_for(load_problem(STIFF))[:2] == [(INDEX1, (CVODE,)), (INDEX1, (EXPLICIT,))]
    assert methods_for(load_problem(CHAIN))[:2] == [(INDEX1, (EXPLICIT,)), (INDEX1, (CVODE,))]
    assert methods_for(load_problem("planar_chain(n_links=1)"))[0] == (GGL, (EXPLICIT,))


@pytest.mark.parametrize(("spec", "other", "bar"), [(STIFF, CVODE, 1e-6), (CHAIN, EXPLICIT, 1e-8)])
def test_bars_on_bushings_are_certified(spec, other, bar, tmp_path: Path):
    file = tmp_path / "bars.json"
    assert certify_one(spec, file, 20.0) == ""
    found = reference_of(file)
    assert found["source"] == f"{INDEX1}, confirmed by {other}"
    assert max(found["bars"][name].max() for name in ("q", "v")) < bar


def test_a_crane_whose_trolley_follows_a_table_is_certified_from_kink_to_kink(tmp_path: Path):
    """Its end by the rope's angle a: 2 a'' = -9.81 sin a, and a' falls by (jump of X') cos a / 2 at each kink."""
    assert certify_one(f"{SCENES}:crane", tmp_path / "crane.json", 20.0) == ""
    found, source = read_certificate(tmp_path / "crane.json"), reference_of(tmp_path / "crane.json")["source"]
    assert source == f"{GGL}, confirmed by {EXPLICIT}, across the jumps of prescribed velocities at t = 1, 2.5, 4"
    end = [found["values"][name][-1] for name in ("q", "v")]
    np.testing.assert_allclose(end, [[2, 3.63417211, -1.15303145], [0, 1.967857, 2.78901068]], atol=1e-7)
    assert max(found["bars"][name].max() for name in ("q", "v")) < 1e-10


def test_the_same_motion_is_certified_backward(tmp_path: Path):
    assert certify_one(f"{SCENES}:crane_back", tmp_path / "back.json", 20.0) == ""
    found = read_certificate(tmp_path / "back.json")
    assert (found["t"][0], found["t"][-1], found["jumps"]) == (6.0, 1.5, [4.0, 2.5])
    np.testing.assert_allclose(found["values"]["q"][-1], [1.0, 0.21229087, -1.83834554], atol=1e-6)
    np.testing.assert_allclose(found["values"]["v"][-1], [2.0, 1.16343183, 0.35845948], atol=1e-6)


def test_no_row_lies_where_a_velocity_has_two_values():
    found = certify(Entry(name="crane", spec=f"{SCENES}:crane", times=(0.5, 1.0, 2.5, 6.0), grid=0))
    assert found.jumps == (1.0, 2.5, 4.0)
    np.testing.assert_array_equal(found.t, [0.5, 6.0])


def test_a_jump_that_leaves_the_motion_open_is_the_one_reason_why_nothing_is_certified(tmp_path: Path):
    said = certify_one(f"{SCENES}:guide", tmp_path / "guide.json", 20.0)
    assert said.startswith("not certified: g_q jumps at t = 1")
    assert ";" not in said
