"""What a solution offers to who asked for it: files, frames, pictures, drift, events, other starts."""

import pickle

import matplotlib as mpl
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol.errors import ProblemError
from hhtbench.solution.result import NOT_KEPT, Solution, Status
from hhtbench.solution.saved import write_arrays

mpl.use("agg")


@pytest.fixture(scope="module")
def swing() -> Solution:
    return hb.solve("simple_pendulum", rtol=1e-4, t_span=(0.0, 1.0))


@pytest.fixture(scope="module")
def estimated() -> Solution:
    return hb.solve("simple_pendulum", accuracy=1e-3, t_span=(0.0, 1.0))


def assert_same(a, b, where=""):
    assert type(a) is type(b), where
    if isinstance(a, np.ndarray):
        np.testing.assert_array_equal(a, b, err_msg=where)
    elif isinstance(a, dict) or (hasattr(a, "__dict__") and not isinstance(a, Status)):
        a, b = (x if isinstance(x, dict) else vars(x) for x in (a, b))
        for name in a:
            if name not in NOT_KEPT:
                assert_same(a[name], b[name], f"{where}.{name}")
    elif isinstance(a, (tuple, list)):
        assert len(a) == len(b), where
        for i, pair in enumerate(zip(a, b, strict=True)):
            assert_same(*pair, f"{where}[{i}]")
    else:
        assert a == b, where


@pytest.mark.parametrize("name", ["swing", "estimated"])
def test_a_saved_solution_comes_back_whole_but_for_dense_output(name, request, tmp_path):
    solution = request.getfixturevalue(name)
    file = solution.save(tmp_path / "run")
    assert file == tmp_path / "run.npz"
    assert_same(solution, Solution.load(file))
    np.testing.assert_array_equal(np.load(file)["q"], solution.q)


def test_a_loaded_solution_says_what_its_file_does_not_hold_and_what_to_do(swing, tmp_path):
    again = Solution.load(swing.save(tmp_path / "run.npz"))
    with pytest.raises(ValueError, match=r"run\.npz holds no dense output: .*t_eval"):
        again(0.5)
    with pytest.raises(ValueError, match=r"from a file .*hhtbench\.measure_drift\(problem, solution\)"):
        again.drift()
    problem = hb.load_problem("simple_pendulum").starting(t_span=(0.0, 1.0))
    assert hb.measure_drift(problem, again).position.max() < 1e-12
    assert Solution.load(again.save(tmp_path / "twice.npz")).file.endswith("twice.npz")


def test_events_and_multipliers_of_a_librarys_own_are_saved_too(tmp_path):
    stopped = hb.solve("simple_pendulum", rtol=1e-4, events=[hb.Event(lambda t, q, v: q[0], terminal=False)])
    assert stopped.t_events[0].size
    assert_same(stopped, Solution.load(stopped.save(tmp_path / "events.npz")))
    carried = hb.solve("simple_pendulum", "ida(form=ggl)", rtol=1e-4)
    assert carried.carried is not None
    assert_same(carried, Solution.load(carried.save(tmp_path / "carried.npz")))


@pytest.mark.parametrize("content", [b"", b"no archive", None])
def test_a_file_that_is_no_saved_solution_is_refused_by_name(content, tmp_path):
    file = tmp_path / "other.npz"
    if content is None:
        np.savez(file, q=np.zeros(3))
    else:
        file.write_bytes(content)
    with pytest.raises(ProblemError, match=r"other\.npz holds no saved solution"):
        Solution.load(file)


@pytest.mark.parametrize(
    "changes",
    [
        {"status": "success"},
        {"q": "text"},
        {"q": np.zeros((3, 2))},
        {"drift_of": "text"},
        {"t": None},
    ],
)
def test_parts_that_do_not_fit_are_refused(changes, swing, tmp_path):
    parts = {name: value for name, value in vars(swing).items() if name not in NOT_KEPT}
    file = write_arrays(tmp_path / "other.npz", {**parts, **changes})
    with pytest.raises(ProblemError, match=r"other\.npz is no saved solution"):
        Solution.load(file)


def test_a_pickle_holds_the_dense_output_and_leaves_the_problems_functions(swing):
    again = pickle.loads(pickle.dumps(swing))
    np.testing.assert_array_equal(again(0.3).q, swing(0.3).q)
    with pytest.raises(ValueError, match="without its problem's functions"):
        again.drift()


def test_drift_is_that_of_the_bench_and_of_every_solver():
    hht = hb.solve("simple_pendulum", rtol=1e-3, t_span=(0.0, 2.0)).drift()
    ida = hb.solve("simple_pendulum", "ida(form=index1)", rtol=1e-3, t_span=(0.0, 2.0)).drift()
    assert hht.sampled == "steps"
    assert hht.position.max() < 1e-14 < 1e-6 < ida.position.max()
    assert hht.energy is not None


def test_a_frame_has_a_column_for_every_component(swing):
    frame = swing.to_pandas()
    assert list(frame) == ["t", "q[0]", "q[1]", "v[0]", "v[1]", "lam[0]"]
    np.testing.assert_array_equal(frame["v[1]"], swing.v[:, 1])


def test_a_picture_has_the_coordinates_the_estimate_and_the_drift(estimated, swing):
    labels = [axis.get_ylabel() for axis in estimated.plot().axes]
    assert labels == [
        "q [m, rad]", "v [m/s, rad/s]", "multipliers lam", "estimated error / scale", "drift / scale at steps",
    ]  # fmt: skip
    figure = swing.plot()
    line = figure.axes[0].lines[1]
    np.testing.assert_array_equal(line.get_ydata(), swing.q[:, 1])
    assert [text.get_text() for text in figure.axes[-1].get_legend().get_texts()][:3] == ["position", "velocity", "energy"]


def test_a_notebook_shows_a_table_and_names_of_others_are_text(swing):
    hostile = hb.Solution(**{**vars(swing), "message": "<script>alert(1)</script>"})
    assert "&lt;script&gt;" in hostile._repr_html_()
    assert "<script>" not in hostile._repr_html_()
    assert "residual_evaluations" in swing._repr_html_()


def test_another_interval_and_start_leave_behind_what_is_known_of_the_problems_own():
    problem = hb.load_problem("simple_pendulum")
    assert problem.starting() is problem
    other = problem.starting(t_span=(0.0, 3.0), v0=[0.0, 0.0])
    assert other.t_span == (0.0, 3.0)
    assert problem.reference is not None or problem.exact is not None
    assert other.reference is None and other.exact is None
    assert hb.solve("simple_pendulum", step=0.01, t_span=(0.0, 0.5)).t[-1] == 0.5


@pytest.mark.parametrize("name", ["q0", "v0"])
def test_a_start_of_another_size_is_refused_by_its_own_name(name):
    with pytest.raises(ProblemError, match=rf"{name} must have shape \(2,\); got \(3,\)"):
        hb.solve("simple_pendulum", **{name: [1.0, 2.0, 3.0]})
