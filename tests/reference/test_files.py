"""Reference files: written and read bit by bit, and what a problem gets of them."""

import numpy as np
import pytest

from hhtbench.campaign.reference import certify
from hhtbench.campaign.reference.files import read_certificate, write_certificate
from hhtbench.protocol.errors import ProblemError
from problems import _common


@pytest.fixture
def written(planned, tmp_path):
    """Certificate and its file, with values that have no short decimals."""
    entry = planned("method=B, form=ode, error=1e-9", times=(1 / 3, 2 / 3, 1.0), note="why", name="fall_a")
    certificate = certify(entry)
    return certificate, write_certificate(certificate, tmp_path)


def test_file_is_named_after_the_entry_and_nothing_is_left_beside_it(written, tmp_path):
    assert written[1] == tmp_path / "fall_a.json"
    assert not list(tmp_path.glob("*.part"))


def test_values_times_and_scales_come_back_bit_by_bit_and_bars_to_two_digits(written):
    certificate, file = written
    stored = read_certificate(file)
    np.testing.assert_array_equal(stored["t"], certificate.t)
    for part, own in (("values", certificate.values), ("scales", certificate.scales)):
        assert stored[part].keys() == own.keys()
        for name, rows in own.items():
            assert stored[part][name].tobytes() == np.ascontiguousarray(rows).tobytes()
    for name, bars in certificate.bars.items():
        np.testing.assert_allclose(stored["bars"][name], bars, rtol=0.1)


def test_file_says_how_it_was_made_and_who_confirmed_it(written):
    stored = read_certificate(written[1])
    assert (stored["note"], stored["stated"], stored["rtol"]) == ("why", [1 / 3, 2 / 3, 1.0], 1e-13)
    assert stored["spec"].endswith(":fall")
    confirmed = [(other["independent"], other["status"]) for other in stored["confirmed_by"]]
    assert confirmed == [(True, "success"), (False, "success")]
    assert stored["confirmed_by"][0]["largest_difference"]["q"] == pytest.approx(5e-10, rel=0.01)
    assert {"python", "jax", "scipy"} <= stored["environment"].keys()


@pytest.mark.parametrize("text", ["{", "[]", '{"schema": "other/1"}'])
def test_other_file_is_refused(tmp_path, text):
    (tmp_path / "a.json").write_text(text, encoding="utf-8")
    with pytest.raises(ProblemError, match=r"a\.json"):
        read_certificate(tmp_path / "a.json")


@pytest.fixture
def library(written, monkeypatch):
    """The folder that the problems read holds the file."""
    monkeypatch.setattr(_common, "REFERENCES", written[1].parent)
    return written[0]


def test_problem_gets_the_rows_up_to_its_end(library):
    for t_end, rows in ((0.5, 1), (2 / 3, 2), (1.0, 3), (9.0, 3)):
        found = _common.load_reference("fall_a", t_end)
        np.testing.assert_array_equal(found["t"], library.t[:rows])
        for name in ("q", "v"):
            np.testing.assert_array_equal(found[name], library.values[name][:rows])
            assert found["bars"][name].shape == (rows,)
        assert (found["lam"].shape, found["mu"].shape) == ((rows, 0), (rows, 0))


def test_problem_that_ends_before_the_first_row_or_has_no_file_gets_none(library):
    assert _common.load_reference("fall_a", 0.3) is None
    assert _common.load_reference("fall_b", 1.0) is None


def test_digits_are_those_that_the_largest_bar_of_q_and_v_leaves(library):
    """1e-9, twice the disagreement, rounded up: eight digits and a bit; the source names the methods."""
    found = _common.load_reference("fall_a", 1.0)
    assert found["digits"] == 8
    assert "method=B" in found["source"]
    assert "moved" not in found["source"]


def test_problem_with_an_uncertified_reference_can_still_be_loaded(planned, tmp_path, monkeypatch):
    write_certificate(certify(planned()), tmp_path)
    monkeypatch.setattr(_common, "REFERENCES", tmp_path)
    found = _common.load_reference("fall", 1.0)
    assert found is None or found["digits"] <= 0
