"""Stepping by hand that is saved and resumed goes on as if it had never stopped (row R3)."""

import copy
import hashlib
import pickle

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.lowering.compile.fingerprint import NoFingerprint, fingerprint
from hhtbench.protocol import NumpySystem, System, parameter
from hhtbench.result import Status
from solvers.hht import HHT, Event
from solvers.hht.run.checkpoint import MAGIC, VERSION
from tests.hht.event_scenes import ACCURACY, FREE, begun, height, wall
from tests.hht.scenes import PENDULUM, Q0, STEPPED, SYSTEMS, V0, bits


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
    solver = HHT(SYSTEMS["jax"])
    assert solver.init_step(0.0, 1.01 * Q0, V0, step=0.01, calc_initcond=True) is Status.success
    other = HHT(SYSTEMS["jax"])
    other.resume(solver.checkpoint())
    assert "calc_initcond moved q0" in other.message == solver.message


def sealed(body, version=VERSION):
    return b"%s %d %s\n" % (MAGIC, version, hashlib.sha256(body).hexdigest().encode()) + body


def test_foreign_bytes_other_versions_and_other_solvers_are_refused_by_name():
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
    for bad in (None, "text", 3, solver.state):
        with pytest.raises(TypeError, match="bytes"):
            resume(bad)
    for other, text in (
        (HHT(SYSTEMS["jax"], alpha=-0.3), "method"),
        (HHT(SYSTEMS["jax"], max_step=0.1), "control"),
        (HHT(SYSTEMS["jax"], without="mass"), "without"),
        (HHT(SYSTEMS["jax"], events=height), "events"),
        (HHT(SYSTEMS["numpy"]), "system"),
    ):
        with pytest.raises(hb.ProblemError, match=f"made by a solver with {text}"):
            other.resume(good)
    assert bits(solver.state)[1] == np.asarray(Q0).tobytes()  # it stands where it stood


@pytest.mark.filterwarnings("ignore:the system is a NumpySystem")
def test_a_checkpoint_of_a_system_of_other_sizes_is_refused():
    saved = begun(SYSTEMS["numpy"]).checkpoint()
    with pytest.raises(hb.ProblemError, match=r"State.lam must have shape \(0,\); got float64 \(1,\)"):
        HHT(NumpySystem(force=PENDULUM["force"])).resume(saved)
    with pytest.raises(hb.ProblemError):
        HHT(FREE).resume(saved)


class Pendulum(System):
    length: object = parameter(1.0)
    shape: str = "rod"

    def force(self, t, q, v):
        return jnp.stack([0.0, -9.81])

    def constraint(self, t, q):
        return jnp.stack([(q @ q - self.length**2) / 2])


def test_a_checkpoint_is_refused_by_a_system_with_another_value_of_a_parameter():
    saved = begun(Pendulum(), "controlled", [1.0, 0.0], [0.0, 0.0]).checkpoint()
    HHT(Pendulum()).resume(saved)
    for other in (Pendulum(length=2.0), Pendulum(length=np.nextafter(1.0, 2.0)), Pendulum(shape="rope")):
        with pytest.raises(hb.ProblemError, match=r"with fingerprint = .*the same system, parameter values"):
            HHT(other).resume(saved)


class Marked(Pendulum):
    mark: object = eqx.field(static=True, default=None)


@pytest.mark.filterwarnings("ignore:A (JAX|NumPy) array is being set as static")
def test_a_fingerprint_is_that_of_the_values_in_every_process():
    assert fingerprint(Pendulum()) == fingerprint(Pendulum(length=jnp.asarray(1.0)))
    long = [np.arange(2000.0) for _ in range(2)]
    long[1][1000] = 0.5  # where a text of the array has three dots
    shapes = [1, 1.0, True, "1", None, (1,), (1, 1), ((1,), 1), [1], {"a": 1}, {"a": (1,)}, Pendulum(), *long, long[0] > 5]
    for field in ("shape", "mark"):
        found = [fingerprint(Marked(**{field: shape})) for shape in shapes]
        assert len(set(found)) == len(shapes)
        assert found == [fingerprint(Marked(**{field: copy.deepcopy(shape)})) for shape in shapes]


def test_what_hides_its_numbers_has_no_fingerprint():
    """Two functions, or two objects, may have one text and do different things."""
    for shape in (lambda: 0, object(), ((lambda: 0),), {"a": np.array([object()])}, Pendulum(shape=str)):
        with pytest.raises(NoFingerprint):
            fingerprint(Pendulum(shape=shape))


@pytest.mark.parametrize(
    ("system", "what"), [(SYSTEMS["numpy"], "is a NumpySystem"), (Pendulum(shape=len), "holds a builtin_function_or_method")]
)
def test_what_a_system_cannot_tell_is_said(system, what):
    saved = begun(system).checkpoint()
    with pytest.warns(UserWarning, match=f"{what}, which has no fingerprint: that it is the checkpoint's.* is not checked"):
        HHT(system).resume(saved)
