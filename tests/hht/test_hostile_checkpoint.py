"""What HHT.resume makes of forged and broken checkpoints: ProblemError, or a legal state (row R3)."""

import base64
import json
import pickle

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol import NumpySystem
from hhtbench.result import Status
from solvers.hht import HHT
from tests.hht.event_scenes import ACCURACY, begun, height, wall
from tests.hht.scenes import PENDULUM, Q0, SYSTEMS, V0
from tests.hht.test_checkpoint import sealed, stepped


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


def test_bytes_that_are_no_checkpoint_behind_a_right_checksum_are_refused(chain):
    make, saved = chain
    for body in (b"", b"\n", b"{}\n", b"null\n", b"[" * 100_000, pickle.dumps(3), saved, b"NaN\n" + saved, b"\xff\n"):
        with pytest.raises(hb.ProblemError, match="none of this solver's"):
            make().resume(sealed(body))


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


def leaves(tree, wanted):
    """Where ``tree`` holds what is ``wanted``: owner and key."""
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
        if wanted(value):
            yield tree, key
        if isinstance(value, dict | list):
            yield from leaves(value, wanted)


def is_float(value):
    return isinstance(value, float)


def told(tree):
    """Like :func:`made_of`, with numbers as they are spelled: JSON reads 1e999 as infinity."""
    text = json.dumps(tree)
    for spelling in SPELLED:
        text = text.replace(f'"{spelling}"', spelling)
    return sealed(text.encode())


SPELLED = ("1e999", "-1e999", "1e-320", "0.0", "-1.0", "1e300")


def test_a_number_too_large_is_refused_wherever_it_stands(chain):
    make, saved = chain
    count = len(list(leaves(parts_of(saved)["integrator"], is_float)))
    assert count >= 10
    for i in range(count):
        for spelling in ("1e999", "-1e999"):
            tree = parts_of(saved)
            owner, key = list(leaves(tree["integrator"], is_float))[i]
            owner[key] = spelling
            with pytest.raises(hb.ProblemError, match="not finite"):
                make().resume(told(tree))


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


def test_what_the_users_functions_raise_while_a_matrix_is_made_again_is_told_by_the_step():
    """And not by ``resume``; the run stays as it was."""
    calls, limit = [], 10**9

    def force(t, q, v):
        calls.append(t)
        if len(calls) > limit:
            raise RuntimeError("broken")
        return np.array([0.0, -9.81])

    system = NumpySystem(**{**PENDULUM, "force": force})
    whole, first, parts = begun(system), HHT(system), HHT(system)
    assert whole.step() is whole.step() is Status.success
    for solver in (first, parts):
        with pytest.warns(UserWarning, match="NumpySystem"):
            solver.resume(whole.checkpoint())
    before = len(calls)
    assert first.step() is Status.success
    needed = len(calls) - before
    assert needed > 3
    for more in (0, 1):  # in the matrix, and behind it
        limit = len(calls) + more
        with pytest.raises(RuntimeError, match="broken"):
            parts.step()
    limit = 10**9
    assert [state for state, *_ in stepped(parts, 10)] == [state for state, *_ in stepped(whole, 10)]


def changed_shape(array, random):
    """Its dimensions anew, with the same product, or with another."""
    count = int(np.prod(array["shape"]))
    array["shape"] = [[count], [1, count], [count, 1], [], [0], [count, 0], [1, 1, count], [count + 1]][random.integers(8)]


def mutated(saved, random):
    """Well-formed JSON with another shape, another array, or another number somewhere."""
    tree = parts_of(saved)
    arrays = [owner for owner, key in leaves(tree["integrator"], lambda value: True) if key == "shape"]
    kind, chosen = random.integers(4), arrays[random.integers(len(arrays))]
    if kind == 0:
        changed_shape(chosen, random)
    elif kind == 1:  # one without numbers or with one may have any number of dimensions
        small = [array for array in arrays if np.prod(array["shape"]) <= 1]
        array = small[random.integers(len(small))]
        array["shape"] = [1] * int(random.integers(4)) if np.prod(array["shape"]) else [0] * int(random.integers(1, 4))
    elif kind == 2:
        chosen |= arrays[random.integers(len(arrays))]
    else:
        places = list(leaves(tree["integrator"], is_float))
        owner, key = places[random.integers(len(places))]
        owner[key] = SPELLED[random.integers(len(SPELLED))]
    return told(tree)


@pytest.mark.filterwarnings("ignore:the system is a NumpySystem", "ignore::RuntimeWarning")
@pytest.mark.parametrize("accuracy", ACCURACY)
@pytest.mark.parametrize("kept", KEPT)
def test_mutated_shapes_and_numbers_are_refused_or_legal(kept, accuracy):
    system, q0, v0, how = KEPT[kept]
    solver, random = begun(system, accuracy, q0, v0, **how), np.random.default_rng(31)
    assert solver.step() is Status.success
    saved, refused = solver.checkpoint(), 0
    for _ in range(60):
        try:
            solver.resume(mutated(saved, random))
        except hb.ProblemError:
            refused += 1
            continue
        assert all(np.isfinite(x).all() for x in (solver.state.t, solver.state.q, solver.state.v, solver.state.a))
        assert isinstance(solver.step(), Status)
    assert 20 < refused < 60


BROKEN_ARRAYS = {
    "a length to be found": (lambda q: q | {"shape": [-1]}, "shape"),
    "a length beyond memory": (lambda q: q | {"shape": [2**62]}, "reshape"),
    "no shape": (lambda q: q | {"shape": None}, "shape"),
    "a shape that is no list": (lambda q: q | {"shape": q["shape"][0]}, "shape"),
    "signs of no meaning": (lambda q: q | {"content": "@" + q["content"]}, "base64"),
    "not a number": (lambda q: array(np.full(q["shape"], np.nan)), "not finite"),
}


@pytest.mark.parametrize("name", BROKEN_ARRAYS)
def test_an_array_is_what_it_says_it_is_or_refused(name, chain):
    make, saved = chain
    tree, (broken, text) = parts_of(saved), BROKEN_ARRAYS[name]
    set_at(tree, "integrator.state.q", broken(tree["integrator"]["state"]["q"]))
    with pytest.raises(hb.ProblemError, match=text):
        make().resume(made_of(tree))


NO_SHAPES = {
    "integrator.tolerances.rtol": [0],
    "integrator.last.t": [],
    "integrator.state.earlier": [],
    "integrator.state.factorised.at": [0],
}


@pytest.mark.parametrize("path", NO_SHAPES)
def test_an_array_of_no_shape_is_refused(path, chain):
    make, saved = chain
    tree = parts_of(saved)
    set_at(tree, path, array(np.zeros(NO_SHAPES[path])))
    with pytest.raises(hb.ProblemError, match="does not fit"):
        make().resume(made_of(tree))
