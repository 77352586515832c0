"""Stepping by hand that is saved and resumed goes on as if it had never stopped (row R3)."""

import hashlib
import json
import pickle
import struct

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.lowering.fingerprint import fingerprint
from hhtbench.protocol import NumpySystem, System, parameter
from hhtbench.result import Status
from solvers.hht import HHT, Event
from solvers.hht.checkpoint import MAGIC, VERSION
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
        (HHT(SYSTEMS["jax"], events=height), "events"),
        (HHT(SYSTEMS["numpy"]), "system"),
    ):
        with pytest.raises(hb.ProblemError, match=f"made by a solver with {text}"):
            other.resume(good)
    assert bits(solver.state)[1] == np.asarray(Q0).tobytes()  # it stands where it stood


@pytest.mark.filterwarnings("ignore:a NumpySystem has no fingerprint")
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


def test_a_fingerprint_is_that_of_the_values_in_every_process():
    assert fingerprint(Pendulum()) == fingerprint(Pendulum(length=jnp.asarray(1.0)))
    assert fingerprint(Pendulum(shape=str)) == fingerprint(Pendulum(shape=str))
    made = [eval("lambda: 0") for _ in range(2)]
    assert repr(made[0]) != repr(made[1])
    assert len({fingerprint(Pendulum(shape=function)) for function in made}) == 1, "where it lies in memory is left out"
    assert fingerprint(SYSTEMS["numpy"]) is None


def test_what_a_numpy_system_cannot_tell_is_said():
    saved = begun(SYSTEMS["numpy"]).checkpoint()
    with pytest.warns(UserWarning, match="has no fingerprint: that it is the checkpoint's.* is not checked"):
        HHT(SYSTEMS["numpy"]).resume(saved)


def parts_of(checkpoint):
    """The JSON of a checkpoint and the bytes of its arrays."""
    line, _, rest = checkpoint.partition(b"\n")[2].partition(b"\n")
    return json.loads(line), rest


def made_of(tree, rest):
    return sealed(json.dumps(tree).encode() + b"\n" + rest)


def set_at(tree, path, value):
    *owners, last = path.split(".")
    for name in owners:
        tree = tree[name]
    tree[last] = value


@pytest.fixture(scope="module")
def chain():
    """A maker of solvers and a checkpoint with every kind of record: step control, events, a factorisation in bands."""
    problem, events = hb.load_problem("planar_chain(n_links=5)"), [height, wall()]
    solver = HHT(problem.system, events=events)
    assert solver.init_step(0.0, problem.q0, problem.v0, rtol=1e-4) is Status.success
    for _ in range(8):
        assert solver.step() is Status.success
    return (lambda: HHT(problem.system, events=events)), solver.checkpoint()


HOSTILE = {
    "standing.type": ["_Reader", "object", "Run", "", None, 3, ["Standing"]],
    "standing.state.type": ["Place", "Standing"],
    "standing.state.factor.type": ["Factor", "DenseFactor", "InverseFactor", "SpluFactor"],
    "standing.state.q": [1.0, None, {"type": "array", "number": -1}, {"type": "array", "number": 10**6}, {"type": "array"}],
    "standing.state.h": [0.0, "x", True, 10**400, 1],
    "standing.state.t": ["__import__('os').system('touch evil')", {"type": "eval"}, [1.0]],
    "standing.state.size_q": [-1.0],
    "standing.state.surprise": [1.0],
    "standing.state.memory.h_next": [0.0, -1.0],
    "standing.step": [0.5],
    "standing.tolerances": [None],
    "standing.direction": [2.0],
    "standing.tally": [{"type": "Counter", "__class__": 1}, {"type": "Counter", "newton_iterations": -1}, {}],
    "standing.watch.counts": [[0], [0, 0, 0], [0, 0.5]],
    "standing.watch.changed": [[7], [-1]],
    "arrays": [[], [["|O", [2]]], [["<f8", [2**62]]], [["<f8", [-1]]], 3],
    "setup": [None, {}, []],
}


@pytest.mark.parametrize("path", HOSTILE)
def test_a_hostile_checkpoint_is_refused(path, chain, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    make, saved = chain
    for value in HOSTILE[path]:
        tree, rest = parts_of(saved)
        set_at(tree, path, value)
        with pytest.raises(hb.ProblemError):
            make().resume(made_of(tree, rest))
    assert not list(tmp_path.iterdir())


def test_bytes_that_are_no_checkpoint_behind_a_right_checksum_are_refused(chain):
    make, saved = chain
    _, rest = parts_of(saved)
    for body in (b"", b"\n", b"{}\n", b"null\n", b"[" * 100_000, pickle.dumps(3), saved, b"NaN\n" + rest, b"\xff\n"):
        with pytest.raises(hb.ProblemError, match="none of this solver's"):
            make().resume(sealed(body))


def test_a_factorisation_whose_places_lie_outside_is_refused(chain):
    """Compiled loops go by them and look at no bound."""
    make, saved = chain
    tree, rest = parts_of(saved)
    starts = np.cumsum([0, *(np.dtype(kind).itemsize * int(np.prod(shape)) for kind, shape in tree["arrays"])])
    refused = 0
    for number, (kind, shape) in enumerate(tree["arrays"]):
        if "i" in kind and np.prod(shape):
            for value in (-1, 2**31 - 1):
                at, code = int(starts[number]), "<i" if kind == "<i4" else "<q"
                bad = rest[:at] + struct.pack(code, value) + rest[at + struct.calcsize(code) :]
                with pytest.raises(hb.ProblemError):
                    make().resume(made_of(tree, bad))
                refused += 1
    assert refused >= 8


def test_mutated_checkpoints_are_refused_or_legal(chain):
    """A thousand, behind the right checksum: ProblemError, or a finite state from which a step can be tried."""
    make, saved = chain
    body, random, solver = saved.partition(b"\n")[2], np.random.default_rng(13), make()
    refused = 0
    for _ in range(1000):
        changed = bytearray(body)
        for at in random.integers(0, len(body), random.integers(1, 4)):
            changed[at] = random.integers(0, 256)
        try:
            solver.resume(sealed(bytes(changed)))
        except hb.ProblemError:
            refused += 1
            continue
        state = solver.state
        assert all(np.isfinite(x).all() for x in (state.t, state.q, state.v, state.a, state.lam))
        assert isinstance(solver.step(), Status)
    assert 100 < refused < 1000
