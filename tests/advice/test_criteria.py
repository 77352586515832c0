from __future__ import annotations

import pytest

from hhtbench.advice.criteria import Criteria, accuracies_of
from hhtbench.protocol.errors import ProblemError


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("1e-2..1e-6", (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)),
        ("1e-6..1e-2", (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)),
        ("0.02..0.0005", (2e-2, 2e-3, 5e-4)),
        ("1e-4", (1e-4,)),
        ("1e-3, 1e-5", (1e-3, 1e-5)),
    ],
)
def test_errors_are_read_as_they_are_written(text, values):
    assert accuracies_of(text) == pytest.approx(values)


@pytest.mark.parametrize(
    "text", ["", "small", "1e-2..", "1e-2..0", "1e-2..x", "inf..1e-3", "1e-3..inf", "nan..1e-3", "1e-2...1e-6"]
)
def test_what_is_no_error_is_refused_with_examples(text):
    with pytest.raises(ProblemError, match=r"1e-2\.\.1e-6"):
        accuracies_of(text)


def test_errors_are_sorted_and_each_once():
    assert Criteria(accuracies=(1e-4, 1e-2, 1e-4)).accuracies == (1e-2, 1e-4)
