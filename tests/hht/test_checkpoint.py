"""Stepping by hand that is saved and resumed goes on as if it had never stopped (row R3)."""

import hashlib
import pickle

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol import NumpySystem
from hhtbench.result import Status
from solvers.hht import HHT, Event
from solvers.hht.stepping import MAGIC, VERSION
from tests.hht.event_scenes import ACCURACY, FREE, begun, height, wall
from tests.hht.scenes import PENDULUM, Q0, SYSTEMS, V0
from tests.hht.test_reproducible import STEPPED, bits


def stepped(solver, count):
    result = []
    for _ in range(count):
        assert solver.step() in (Status.success, Status.event), solver.message
        result.append([bits(solver.state), [(o.name, o.t) for o in solver.occurrences], solver.counters])
    return result


SAVED = [(scene, "constant") for scene in STEPPED] + [
    ("jax", "controlled"),
    ("numpy", "controlled"),
    ("singular mass", "controlled"),
]


@pytest.mark.filterwarnings("ignore:Newton's iteration failed with the declared")
@pytest.mark.parametrize(("scene", "accuracy"), SAVED)
def test_a_run_that_was_checkpointed_and_resumed_goes_on_bit_by_bit(scene, accuracy):
    system, q0, v0 = STEPPED[scene]
    whole = begun(system, accuracy, q0, v0, alpha=-0.3)
    parts = begun(system, accuracy, q0, v0, alpha=-0.3)
    expected = stepped(whole, 30)
    found = []
    for count in (0, 1, 2, 17, 10):  # saved before the first step, after one, after two, later
        found += stepped(parts, count)
        saved = parts.checkpoint()
        parts = HHT(system, alpha=-0.3)
        parts.resume(saved)
        assert parts.counters == (found[-1][2] if found else parts.counters)
    assert found == expected
    at = parts.state.t
    assert parts.interpolate(at).q.tobytes() == whole.interpolate(at).q.tobytes()
    assert parts.checkpoint() == saved


@pytest.mark.parametrize("accuracy", ACCURACY)
def test_occurrences_go_on_counting_after_a_checkpoint(accuracy):
    events = [wall(), Event(lambda t, q, v: q[0] - 0.4, terminal=3, name="third")]
    whole, parts = (begun(accuracy=accuracy, events=events) for _ in range(2))
    statuses = [solver.step(1.2, "normal") for solver in (whole, parts)]
    assert statuses == [Status.success] * 2
    saved, parts = parts.checkpoint(), HHT(SYSTEMS["jax"], events=events)
    parts.resume(saved)
    for solver in (whole, parts):
        assert solver.step(3.0, "normal") is Status.event
        assert solver.occurrences[-1].name == "third"
    assert bits(whole.state) == bits(parts.state)
    assert whole.message == parts.message
    assert whole.counters == parts.counters


def test_a_checkpoint_keeps_the_message():
    solver = HHT(SYSTEMS["jax"], calc_initcond=True)
    assert solver.init_step(0.0, 1.01 * Q0, V0, step=0.01) is Status.success
    other = HHT(SYSTEMS["jax"], calc_initcond=True)
    other.resume(solver.checkpoint())
    assert "calc_initcond moved q0" in other.message == solver.message


class Evil:
    """Runs code when a careless reader opens it."""

    def __reduce__(self):
        return (eval, ("__import__('pathlib').Path('evil').touch()",))


def sealed(body, version=VERSION):
    return b"%s %d %s\n" % (MAGIC, version, hashlib.sha256(body).hexdigest().encode()) + body


def test_foreign_bytes_other_versions_and_other_solvers_are_refused_by_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    solver = begun()
    good = solver.checkpoint()
    resume = solver.resume
    for bad in (b"", b"\n", b"anything", b"x" * 1000, pickle.dumps(3), good[3:]):
        with pytest.raises(hb.ProblemError, match="these are not"):
            resume(bad)
    for bad in (good[:-1], good[:100], good + b"0", good[:-9] + bytes([good[-9] ^ 1]) + good[-8:]):
        with pytest.raises(hb.ProblemError, match="damaged"):
            resume(bad)
    with pytest.raises(hb.ProblemError, match=f"version {VERSION + 1}"):
        resume(sealed(b"", VERSION + 1))
    with pytest.raises(hb.ProblemError, match="none of this solver's"):
        resume(sealed(pickle.dumps(Evil())))
    assert not list(tmp_path.iterdir())
    for bad in (None, "text", 3, solver.state):
        with pytest.raises(TypeError, match="bytes"):
            resume(bad)
    for other, text in (
        (HHT(SYSTEMS["jax"], alpha=-0.3), "method"),
        (HHT(SYSTEMS["jax"], max_step=0.1), "control"),
        (HHT(SYSTEMS["jax"], events=height), "events"),
        (HHT(SYSTEMS["numpy"]), "system"),
    ):
        with pytest.raises(hb.ProblemError, match=f"made by a solver with {text}"):
            other.resume(good)
    assert bits(solver.state)[1] == np.asarray(Q0).tobytes()  # it stands where it stood


def test_a_checkpoint_of_a_system_of_other_sizes_is_refused():
    saved = begun(SYSTEMS["numpy"]).checkpoint()
    with pytest.raises(hb.ProblemError, match=r"2 coordinates and 1 \+ 0 constraints"):
        HHT(NumpySystem(force=PENDULUM["force"])).resume(saved)
    with pytest.raises(hb.ProblemError):
        HHT(FREE).resume(saved)
