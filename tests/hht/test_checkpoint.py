"""Stepping by hand that is saved and resumed goes on as if it had never stopped (row R3)."""

import base64
import copy
import hashlib
import json
import pickle
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.conformance.scenes.linkages import DoublePendulum
from hhtbench.lowering.compile.fingerprint import fingerprints
from hhtbench.lowering.contents import NoContents
from hhtbench.protocol.events import Event
from hhtbench.protocol.system import NumpySystem, System, parameter
from hhtbench.solution.result import Status
from solvers.hht import HHT
from solvers.hht.run.checkpoint import MAGIC, VERSION
from tests.hht.event_scenes import ACCURACY, FREE, begun, height, wall
from tests.hht.scenes import ALPHAS, JAX_PENDULUM, PENDULUM, Q0, STEPPED, SYSTEMS, V0, bits


def stepped(solver, count):
    result = []
    for _ in range(count):
        assert solver.step() in (Status.success, Status.event), solver.message
        result.append([bits(solver.state), [(o.name, o.t) for o in solver.occurrences], solver.counters])
    return result


SAVED = [(scene, "constant", {}) for scene in STEPPED]
SAVED += [(scene, "controlled", {}) for scene in ("jax", "numpy", "singular mass")]
SAVED += [("rods", accuracy, {"extrapolate_reaction": True}) for accuracy in ACCURACY]
COPIES = {"pickled": lambda hht: pickle.loads(pickle.dumps(hht)), "copied": copy.deepcopy}
SCENES = {**STEPPED, "rods": (DoublePendulum(ratio=1e4), *DoublePendulum.straight(0.5))}


@pytest.mark.filterwarnings("ignore:Newton's iteration failed with the declared")
@pytest.mark.parametrize(("scene", "accuracy", "options"), SAVED)
def test_a_run_that_was_checkpointed_and_resumed_goes_on_bit_by_bit(scene, accuracy, options):
    system, q0, v0 = SCENES[scene]
    whole, parts = (begun(system, accuracy, q0, v0, alpha=-0.3, **options) for _ in range(2))
    expected = stepped(whole, 30)
    found = []
    for count in (0, 1, 2, 17, 10):  # saved before the first step, after one, after two, later
        found += stepped(parts, count)
        saved = parts.checkpoint()
        parts = HHT(system, alpha=-0.3, **options)
        parts.resume(saved)
        assert parts.counters == (found[-1][2] if found else parts.counters)
    assert found == expected
    at = parts.state.t
    assert parts.interpolate(at).q.tobytes() == whole.interpolate(at).q.tobytes()
    assert parts.checkpoint() == saved


@pytest.mark.parametrize("copied", COPIES)
@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("accuracy", ACCURACY)
def test_a_solver_that_was_pickled_or_copied_in_mid_run_goes_on_bit_by_bit(accuracy, alpha, copied):
    whole, parts = (begun(SYSTEMS["jax"], accuracy, alpha=alpha) for _ in range(2))
    expected, found = stepped(whole, 40), []
    for count in (0, 1, 2, 17, 20):
        found += stepped(parts, count)
        parts = COPIES[copied](parts)
    assert found == expected


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
        (HHT(SYSTEMS["jax"], extrapolate_reaction=True), "method"),
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
    for other, name in (
        (Pendulum(length=2.0), "length = 1.0; this one has 2.0"),
        (Pendulum(length=np.nextafter(1.0, 2.0)), "length = 1.0; this one has 1.0000000000000002"),
        (Pendulum(shape="rope"), "shape"),
    ):
        with pytest.raises(hb.ProblemError, match=f"with parameter {name}.*the same system, parameter values"):
            HHT(other).resume(saved)


class Marked(Pendulum):
    mark: object = eqx.field(static=True, default=None)


@pytest.mark.filterwarnings("ignore:A (JAX|NumPy) array is being set as static")
def test_a_fingerprint_is_that_of_the_values_in_every_process():
    assert fingerprints(Pendulum()) == fingerprints(Pendulum(length=jnp.asarray(1.0)))
    long = [np.arange(2000.0) for _ in range(2)]
    long[1][1000] = 0.5  # where a text of the array has three dots
    shapes = [1, 1.0, True, "1", None, (1,), (1, 1), ((1,), 1), [1], {"a": 1}, {"a": (1,)}, Pendulum(), *long, long[0] > 5]
    for field in ("shape", "mark"):
        found = [fingerprints(Marked(**{field: shape}))[field] for shape in shapes]
        assert len(set(found)) == len(shapes)
        assert found == [fingerprints(Marked(**{field: copy.deepcopy(shape)}))[field] for shape in shapes]


def test_what_hides_its_numbers_has_no_fingerprint():
    """Two functions, or two objects, may have one text and do different things."""
    for shape in (lambda: 0, object(), ((lambda: 0),), {"a": np.array([object()])}, Pendulum(shape=str)):
        with pytest.raises(NoContents):
            fingerprints(Pendulum(shape=shape))


@pytest.mark.parametrize(
    ("system", "what"), [(SYSTEMS["numpy"], "is a NumpySystem"), (Pendulum(shape=len), "holds a builtin_function_or_method")]
)
def test_what_a_system_cannot_tell_is_said(system, what):
    saved = begun(system).checkpoint()
    with pytest.warns(UserWarning, match=f"{what}, which has no fingerprint: that it is the checkpoint's.* is not checked"):
        HHT(system).resume(saved)


def parts_of(checkpoint):
    """The JSON of a checkpoint."""
    return json.loads(checkpoint.partition(b"\n")[2])


def made_of(tree):
    return sealed(json.dumps(tree).encode())


def array(values, shape=None):
    """As a checkpoint holds it."""
    content = base64.b64encode(np.asarray(values, dtype=float).tobytes()).decode()
    return {"type": "array", "shape": list(np.shape(values)) if shape is None else shape, "content": content}


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
    "integrator.type": ["_Reader", "object", "Run", "", None, 3, ["IntegratorState"]],
    "integrator.state.type": ["PhasePoint", "IntegratorState"],
    "integrator.state.factorised.type": ["State", "ControlMemory", "Factor"],
    "integrator.state.q": [
        1.0,
        None,
        {"type": "array", "shape": [1], "content": "AAAA"},
        {"type": "array", "shape": [1], "content": "@@@@"},
        {"type": "array", "shape": [1], "content": 3},
        {"type": "array"},
    ],
    "integrator.state.h": [0.0, "x", True, 10**400, 1],
    "integrator.state.t": ["__import__('os').system('touch evil')", {"type": "eval"}, [1.0]],
    "integrator.state.memory.h_next": [0.0, -1.0],
    "integrator.tally": [{"type": "Counter", "__class__": 1}, {"type": "Counter", "newton_iterations": -1}, {}],
    "integrator.watch.counts": [[0], [0, 0, 0], [0, 0.5]],
    "setup": [None, {}, []],
}


@pytest.mark.parametrize("path", HOSTILE)
def test_a_hostile_checkpoint_is_refused(path, chain, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    make, saved = chain
    for value in HOSTILE[path]:
        tree = parts_of(saved)
        set_at(tree, path, value)
        with pytest.raises(hb.ProblemError):
            make().resume(made_of(tree))
    assert not list(tmp_path.iterdir())


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


@pytest.mark.parametrize("size", [2, 10**6])
def test_a_state_of_another_length_is_refused(size):
    hht = HHT(JAX_PENDULUM)
    hht.init_step(0.0, Q0, V0, step=0.01)
    assert hht.step() is Status.success
    before = hht.state
    hht.restart(replace(before, factorised=replace(before.factorised, at=np.zeros(size))))
    with pytest.raises(hb.ProblemError, match="arrays are of other lengths"):
        hht.step()
    hht.restart(before)
    assert hht.step() is Status.success
