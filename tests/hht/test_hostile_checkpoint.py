"""What HHT.resume makes of forged and broken checkpoints: ProblemError, or a legal state (row R3)."""

import base64
import json
from dataclasses import replace

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.result import Status
from solvers.hht import HHT
from tests.hht.event_scenes import ACCURACY, begun, height, wall
from tests.hht.scenes import JAX_PENDULUM, Q0, SYSTEMS, V0
from tests.hht.test_checkpoint import sealed


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
    "integrator.state.type": ["Place", "IntegratorState"],
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
    "integrator.state.size_q": [-1.0],
    "integrator.state.surprise": [1.0],
    "integrator.state.memory.h_next": [0.0, -1.0],
    "integrator.step": [0.5],
    "integrator.tolerances": [None],
    "integrator.direction": [2.0],
    "integrator.tally": [{"type": "Counter", "__class__": 1}, {"type": "Counter", "newton_iterations": -1}, {}],
    "integrator.watch.counts": [[0], [0, 0, 0], [0, 0.5]],
    "integrator.watch.changed": [[7], [-1]],
    "integrator.watch.sides": [[1], [0, 0, 0, 0]],
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


LINKS = hb.load_problem("planar_chain(n_links=5)")
CHAIN = LINKS.system, LINKS.q0, LINKS.v0
KEPT = {  # what a factorisation is kept by
    "inverse": (SYSTEMS["jax"], Q0, V0, {}),
    "callbacks": (SYSTEMS["numpy"], Q0, V0, {}),
    **{kind: (*CHAIN, {"linsolver": kind}) for kind in ("dense", "band", "sparse")},
}


def forged(saved, change):
    """A checkpoint after ``change(factorised, at, step)`` of where its matrix was made: from ``step`` on h and the rest."""
    tree = parts_of(saved)
    state = tree["integrator"]["state"]
    at = np.frombuffer(base64.b64decode(state["factorised"]["at"]["content"])).copy()
    change(state["factorised"], at, state["unknowns"]["shape"][0])
    state["factorised"]["at"] = array(at)
    return made_of(tree)


def scaled(by):
    def change(factorised, at, step):
        at *= by

    return change


def made_for(h):
    """As if made for a step of h [s]: its changes of q and v would all be small."""

    def change(factorised, at, step):
        at[step] = h

    return change


def far_away(factorised, at, step):
    """Where all but the step is large, and so the entries of the matrix."""
    at[np.arange(at.size) != step] *= 1e8


def with_field(**values):
    return lambda factorised, at, step: factorised.update(values)


FORGED = {
    "a place of zeros": scaled(0.0),
    "a place far away": far_away,
    "a place beyond numbers": scaled(1e150),
    "a place nearby": scaled(1.1),
    "for a short step": made_for(1e-150),
    "for no step": made_for(0.0),
    "no length": made_for(5e-324),
    "another length": made_for(0.5),
    "a rate of nothing": with_field(rate=0.0),
    "a rate beyond one": with_field(rate=1e300),
    "used for ages": with_field(uses=2**62),
}


@pytest.mark.filterwarnings("ignore:the system is a NumpySystem")
@pytest.mark.parametrize("name", FORGED)
@pytest.mark.parametrize("accuracy", ACCURACY)
@pytest.mark.parametrize("kept", KEPT)
def test_a_forged_factorisation_is_refused_or_changes_no_motion(kept, accuracy, name):
    """Newton's iteration believes the kept one: it could call any guess a solution."""
    system, q0, v0, how = KEPT[kept]
    solver, other = begun(system, accuracy, q0, v0, **how), HHT(system, **how)
    for _ in range(5):
        assert solver.step() is Status.success
    try:
        other.resume(forged(solver.checkpoint(), FORGED[name]))
    except hb.ProblemError:
        return
    close = {"rtol": 0, "atol": (1e-10 if accuracy == "constant" else 1e-4) * np.abs(solver.state.q).max()}
    for _ in range(5 if accuracy == "constant" else 1):
        assert solver.step() is Status.success
        for _ in range(20):
            assert other.step(tstop=solver.state.t) is Status.success, other.message
            if other.state.t == solver.state.t:
                break
        assert other.state.t == solver.state.t
        np.testing.assert_allclose(other.state.q, solver.state.q, **close)


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
