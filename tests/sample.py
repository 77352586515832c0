"""The problems of the library: `make test` takes a sample of them with each other thing, `make test-slow` takes all."""

import pytest

from hhtbench import list_problems

SAMPLE = (  # each kind of constraint, mass and reaction, bodies in space, a stiff, a singular and a redundant one
    *("andrews", "fput_chain", "heavy_top", "jay_negrut_test1", "kapitza_pendulum", "knife_edge", "redundant_pendulum"),
    *("rolling_sphere_table", "simple_pendulum", "slider_crank_equal_lengths", "stiff_spring_pendulum"),
)


def slow(*values):
    """Parameters of a case that `make test-slow` takes alone."""
    return pytest.param(*values, marks=pytest.mark.long)


LIBRARY = [pytest.param(name) if name in SAMPLE else slow(name) for name in list_problems()]
