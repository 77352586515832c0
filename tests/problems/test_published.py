"""Our certified references against values that others published, through the mapping of ``published_*.py``."""

import json
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest

import solvers.hht.verify
from hhtbench.catalogue.registry import list_problems
from hhtbench.catalogue.specs import parse_spec
from problems import _common
from tests.problems import published_chains, published_tables
from tests.problems.published import ABOUT, NO_PROBLEM, STORED, State

PUBLISHED = published_tables.PUBLISHED | published_chains.PUBLISHED
QUANTITIES = ("q", "v", "lam", "mu")
EPS = float(np.finfo(np.float64).eps)


def same_problem(spec):
    """What two specs of one problem share: everything but the end of the interval."""
    parsed = parse_spec(spec)
    return parsed.name, {key: value for key, value in parsed.arguments.items() if key != "t_end"}


@pytest.fixture(scope="module")
def references():
    """The stored reference files."""
    return [json.loads(file.read_text(encoding="utf-8")) for file in sorted(_common.REFERENCES.glob("*.json"))]


def reference_at(references, spec, t):
    """State and absolute error bars (quantity -> (size,)) of the reference of ``spec`` at a stated time."""
    found = [stored for stored in references if same_problem(stored["spec"]) == same_problem(spec)]
    assert found, f"no reference of {spec} is stored"
    stored = found[0]
    times = np.array(stored["t"])
    row = int(np.argmin(np.abs(times - t)))
    assert abs(times[row] - t) < 1e-12, f"the reference of {spec} has no row at {t}"
    parts = {name: np.array(stored["values"].get(name, [()] * times.size)[row]) for name in QUANTITIES}
    bars = {name: stored["bars"].get(name, [0.0] * times.size)[row] * sizes(stored, name) for name in QUANTITIES}
    return State(spec, t, **parts), bars


def sizes(stored, name):
    return np.array(stored["scales"].get(name, ()))


def carried(function, state, bars):
    """Error bars through ``function``: the sum of its slopes times the bars."""
    at = np.ravel(function(state))
    total = np.zeros(at.size)
    for name, bar in bars.items():
        x = np.asarray(getattr(state, name))
        step = 1e-6 * (1 + np.abs(x))
        if x.size == 0 or np.array_equal(np.ravel(function(state.moved(name, x + step))), at):
            continue
        for i in range(x.size):
            moved = np.ravel(function(state.moved(name, x + step * (np.arange(x.size) == i))))
            total += np.abs(moved - at) / step[i] * bar[i]
    return total


def numbers(stored):
    """Published numbers of one row and half a unit of their last printed digits."""
    printed = [Decimal(str(x)) for x in np.ravel(stored)]
    halves = [0.5 * 10.0 ** x.as_tuple().exponent for x in printed]
    return np.array([float(x) for x in printed]), np.array(halves)


def rows_of(entry, key, published):
    """(time, published numbers of that time)."""
    times = published.times.get(key, entry["t"])
    return zip(times, entry[key], strict=True) if isinstance(times, list) else [(times, entry[key])]


@pytest.mark.parametrize("name", PUBLISHED)
def test_reference_agrees_with_the_published_values_to_the_lesser_of_both_error_bars(references, name):
    """Theirs is half a unit of the last printed digit, or the digits they confirm where the mapping says so."""
    entry, published = STORED[name], PUBLISHED[name]
    wrong = []
    for key, function in published.values.items():
        largest = max(np.abs(numbers(row)[0]).max() for _, row in rows_of(entry, key, published))
        for t, row in rows_of(entry, key, published):
            if t > published.after:
                state, bars = published.instead(float(t)), {}
            else:
                state, bars = reference_at(references, published.spec, float(t))
            ours, (theirs, half) = np.ravel(function(state)), numbers(row)
            assert ours.shape == theirs.shape
            bar = carried(function, state, bars) + half + 2 * EPS * np.abs(ours)
            bar += largest * (published.bar if not bars else 0.0 if published.digits is None else 10.0**-published.digits)
            assert np.isfinite(bar).all(), f"{key} at {t}: the reference is not certified"
            if (excess := np.abs(ours - theirs) / bar).max() > 1:
                wrong.append(f"{key} at {t} s: {np.abs(ours - theirs).max():.1e}, {excess.max():.1f} of its error bar")
    assert not wrong, "\n".join(wrong)


def test_every_published_entry_and_key_is_compared_or_left_out_with_a_reason():
    assert PUBLISHED.keys().isdisjoint(NO_PROBLEM)
    assert STORED.keys() == PUBLISHED.keys() | NO_PROBLEM.keys()
    assert all(NO_PROBLEM.values())
    for name, published in PUBLISHED.items():
        keys = STORED[name].keys() - ABOUT
        assert published.values.keys().isdisjoint(published.left_out), name
        assert keys == published.values.keys() | published.left_out.keys(), name
        assert all(published.left_out.values()), name
        assert parse_spec(published.spec).name in list_problems()
        assert published.digits in (None, STORED[name].get("digits_verified")), name
        beyond = {published.instead is not None, bool(published.why), published.bar > 0, published.after < np.inf}
        assert len(beyond) == 1, name


def test_published_errors_of_the_method_are_those_that_its_verification_compares():
    """Figures 5.1 and 5.2 of Jay and Negrut as numbers."""
    mine = json.loads(Path(solvers.hht.verify.__file__).with_name("independent_errors.json").read_text(encoding="utf-8"))
    entry = STORED["expected_extended_hht_errors"]
    first = entry["test1_alpha-0.15_b0.3_a0=f(t0)"]
    for ours, theirs in {"steps": "N", "q": "err_y_2norm", "v": "err_z_2norm", "a": "err_a_2norm"}.items():
        assert mine["test1"][ours] == first[theirs]
    for case, alpha in zip(mine["pendulum"], ("0", "-0.3"), strict=True):
        for ours, theirs in {"step": "h", "y3": "err_y3", "z3": "err_z3"}.items():
            assert case[ours] == entry[f"pendulum_alpha{alpha}_b0"][theirs]
