"""Who counts as independent, and how large the error bars become."""

import numpy as np
import pytest

from hhtbench.campaign.reference import certify
from hhtbench.campaign.reference.certify import FLOOR, SAFETY
from hhtbench.protocol.errors import ProblemError

OTHER = "method=B, form=ode"


def test_bar_is_the_scaled_disagreement_with_the_independent_solver(planned):
    """q differs by 1e-6 of a scale 2; v, which agrees, keeps the bar of the last bits of a double."""
    certificate = certify(planned(f"{OTHER}, error=1e-6"))
    assert certificate.certified
    np.testing.assert_allclose(certificate.bars["q"], SAFETY * 5e-7, rtol=1e-6)
    np.testing.assert_array_equal(certificate.bars["v"], FLOOR)
    np.testing.assert_array_equal(certificate.t, [0.5, 1.0])
    np.testing.assert_array_equal(certificate.values["v"], [[-5.0], [-10.0]])
    assert certificate.digits("q") == pytest.approx(6.0, abs=0.01)


def test_bar_of_an_observable_is_in_its_largest_value(planned):
    certificate = certify(planned(f"{OTHER}, error=1e-6"))
    np.testing.assert_array_equal(certificate.scales["observable height"], [4.0])  # 1 - 5 t^2 at the end
    np.testing.assert_allclose(certificate.bars["observable height"], SAFETY * 2.5e-7, rtol=1e-6)


@pytest.mark.parametrize(
    "second",
    [
        ("method=A, form=ode, error=1e-9",),  # the same family
        ("method=B, form=ggl, error=1e-9",),  # the same form
        ("method=A, form=ode, error=1e-9", "method=B, form=ggl, error=1e-9"),
        ("method=B, form=ode, fails=True",),  # independent, but it does not reach the end
        (),
    ],
)
def test_nobody_of_another_family_and_form_leaves_the_reference_uncertified_with_infinite_bars(planned, second):
    certificate = certify(planned(*second))
    assert not certificate.certified
    assert all(np.isinf(bars).all() for bars in certificate.bars.values())
    assert all(not other.independent or not other.difference for other in certificate.confirmations)


@pytest.mark.parametrize("names", [("radau", "Radau"), ("BDF", "bdf")])
def test_two_codes_of_one_method_are_one_family(planned, names):
    one, other = names
    assert not certify(planned(f"method={other}, form=ode", first=f"method={one}")).certified


def test_solver_that_does_not_count_does_not_enter_the_bar(planned):
    certificate = certify(planned("method=A, form=ode, error=1e-3", f"{OTHER}, error=1e-9"))
    assert certificate.certified
    assert [other.independent for other in certificate.confirmations] == [False, True, False]
    np.testing.assert_allclose(certificate.bars["q"], SAFETY * 5e-10, rtol=1e-4)


def test_bar_never_falls_with_time(planned):
    """An error that is gone at later times has still been there: the disagreement counts from then on."""
    early = certify(planned(f"{OTHER}, error=1e-6, late=-1e-6", times=(0.25, 0.5, 1.0)))
    np.testing.assert_allclose(early.bars["q"], SAFETY * 5e-7, rtol=1e-6)
    late = certify(planned(f"{OTHER}, late=1e-6", times=(0.0, 0.5, 1.0)))
    np.testing.assert_allclose(late.bars["q"], [FLOOR, FLOOR, SAFETY * 5e-7], rtol=1e-6)


def test_what_the_last_bit_of_the_start_does_enters_the_bar(planned):
    """1 and its neighbour differ by 2.2e-16; the first solver makes 2.2e-9 of it, the second agrees."""
    certificate = certify(planned(OTHER, first="gain=1e7"))
    assert certificate.certified
    np.testing.assert_allclose(certificate.bars["q"], SAFETY * 2.0**-52 * 1e7 / 2, rtol=1e-6)
    assert not certificate.confirmations[-1].independent


def test_closed_solution_confirms_by_itself(planned):
    certificate = certify(planned(problem="fall(known=True)", first="error=1e-8"))
    assert certificate.certified
    np.testing.assert_allclose(certificate.bars["q"], SAFETY * 5e-9, rtol=1e-6)


def test_error_against_the_closed_solution_is_never_above_the_bar(planned):
    """Two solvers that err together do not make the bar smaller than the error that is known."""
    certificate = certify(planned(f"{OTHER}, error=1e-6", first="error=1e-6", problem="fall(known=True)"))
    assert np.all(certificate.bars["q"] >= 4.999e-7)


def test_first_solver_that_stops_leaves_nothing_to_store(planned):
    with pytest.raises(ProblemError, match=r"fall: .*Told\(fails=True\) ended with .*as told"):
        certify(planned(OTHER, first="fails=True"))
