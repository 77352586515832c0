from __future__ import annotations

import gc
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hhtbench.catalogue.specs import Spec, canonical, parse_spec
from hhtbench.protocol.errors import ProblemError

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.tuples(inner) | st.tuples(inner, inner),
    max_leaves=5,
)


@pytest.mark.parametrize(
    ("text", "name", "path", "arguments"),
    [
        ("andrews", "andrews", None, {}),
        (" andrews() ", "andrews", None, {}),
        ("planar_chain(n_links=100)", "planar_chain", None, {"n_links": 100}),
        ("my_file.py:name(k=1)", "name", "my_file.py", {"k": 1}),
        ("a folder (2)/it's/my_file.py:name", "name", "a folder (2)/it's/my_file.py", {}),
        ("C:\\dir\\my.py:name", "name", "C:\\dir\\my.py", {}),
        ("hht(alpha=-1/3, reaction=midpoint)", "hht", None, {"alpha": -1 / 3, "reaction": "midpoint"}),
        ("stiff(stiffness=1e8)", "stiff", None, {"stiffness": 1e8}),
        ("a(k=2**-5, l=-2**2, m=7//2, n=7%4)", "a", None, {"k": 0.03125, "l": -4, "m": 3, "n": 3}),
        ("a(k=[1, (2, word)], l=(), m='x, y=1')", "a", None, {"k": [1, (2, "word")], "l": (), "m": "x, y=1"}),
        ("a(k=True, l=False, m=None)", "a", None, {"k": True, "l": False, "m": None}),
        ("a(file='other.py:b(1)')", "a", None, {"file": "other.py:b(1)"}),
        ("f.py:a(file='other.py:b(1)')", "a", "f.py", {"file": "other.py:b(1)"}),
    ],
)
def test_spec_is_name_or_file_with_keyword_arguments(text, name, path, arguments):
    spec = parse_spec(text)
    assert (spec.name, spec.path, spec.arguments) == (name, path, arguments)
    assert [type(value) for value in spec.arguments.values()] == [type(value) for value in arguments.values()]


@pytest.mark.parametrize(
    ("text", "reason", "column"),
    [
        ("chain(100)", "given by name", 6),
        ("chain(**n)", "given by name", 6),
        ("chain(n=1", "closing parenthesis is missing", 9),
        ("chain(n=1) x", "nothing may follow", 10),
        ("chain(n=1)(m=2)", "closing parenthesis", 5),
        ("chain(n=1, n=2)", "given twice", 11),
        ("chain(n=f(1))", "a value must be", 8),
        ("chain(é=1, n=a.b)", "a value must be", 13),
        ("chain(n=1j)", "a value must be", 8),
        ("chain(n=1/0)", "division by zero", 8),
        ("chain(n=9**9**9)", "too large", 8),
        ("chain(n=(-8)**0.5)", "not real", 8),
        ("chain(n=1e999)", "must be finite", 8),
        ("$", "name or FILE.py:name", 0),
        ("two words", "name or FILE.py:name", 3),
    ],
)
def test_unreadable_spec_is_shown_with_the_place_and_an_example(text, reason, column):
    with pytest.raises(ProblemError, match="cannot read this spec") as caught:
        parse_spec(text)
    _, shown, marker, example = str(caught.value).splitlines()
    assert reason in str(caught.value)
    assert shown == f"    {text}"
    assert marker.index("^") - 4 == column
    assert "planar_chain(n_links=100)" in example


@pytest.mark.parametrize("text", ["chain(n=)", "chain(n=[1)", "chain(lambda=1)", "chain(n='a)"])
def test_what_python_cannot_parse_is_refused_at_a_place_inside_the_parentheses(text):  # words and column are Python's
    with pytest.raises(ProblemError, match="cannot read this spec") as caught:
        parse_spec(text)
    marker = str(caught.value).splitlines()[2]
    assert len("chain(") <= marker.index("^") - 4 <= len(text)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "must not be empty"),
        ("   ", "must not be empty"),
        ("my_file.py", "my_file.py is a file; add the name of the problem in it, for example my_file.py:problem"),
        ("my_file.py(k=1)", "my_file.py is a file; add the name of the problem in it"),
    ],
)
def test_spec_without_a_name_is_refused_with_an_example(text, reason):
    with pytest.raises(ProblemError, match=reason):
        parse_spec(text)


@pytest.mark.parametrize("text", ["chain(n=1,\nm=2)", "a\x00b", "chain(n='\x1b[2J')"])
def test_spec_that_would_spoil_the_terminal_is_refused(text):
    with pytest.raises(ProblemError, match="one line of printable text") as caught:
        parse_spec(text)
    assert text not in str(caught.value)


@pytest.mark.parametrize("value", [None, 3, ["andrews"]])
def test_spec_that_is_no_string_is_a_type_error(value):
    with pytest.raises(TypeError, match="a spec must be a string"):
        parse_spec(value)


def test_specs_that_mean_the_same_have_one_canonical_form():
    assert canonical("hht( reaction = midpoint,alpha=-1/4 )") == "hht(alpha=-0.25, reaction='midpoint')"
    assert canonical("hht(alpha=-0.25, reaction='midpoint')") == "hht(alpha=-0.25, reaction='midpoint')"
    assert canonical("andrews()") == canonical("andrews") == "andrews"


@settings(deadline=None)  # a busy machine is no failure
@given(st.dictionaries(st.sampled_from(["k", "alpha", "n_links"]), VALUES))
def test_canonical_form_is_read_back_as_the_same_spec(arguments):
    spec = Spec(name="chain", arguments=arguments)
    assert parse_spec(str(spec)) == spec
    assert canonical(str(spec)) == str(spec)


def test_value_without_a_form_in_a_spec_has_no_canonical_form():
    with pytest.raises(ProblemError, match="k=nan has no form"):
        str(Spec(name="a", arguments={"k": float("nan")}))


def test_threads_parse_specs_side_by_side():
    gc.callbacks.append(pause := lambda *_: sum(range(50)))  # lets threads change places within the parser
    interval, threshold = sys.getswitchinterval(), gc.get_threshold()
    sys.setswitchinterval(1e-6)
    gc.set_threshold(20)
    try:
        with ThreadPoolExecutor(6) as pool:
            found = list(pool.map(lambda k: parse_spec(f"rod(a={k}, b=[1, 2, 3, 4, 5, 6])").arguments["a"], range(4000)))
    finally:
        gc.callbacks.remove(pause)
        gc.set_threshold(*threshold)
        sys.setswitchinterval(interval)
    assert found == list(range(4000))
