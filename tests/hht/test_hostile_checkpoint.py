"""What HHT.resume makes of forged and broken checkpoints: ProblemError, or a legal state (row R3)."""

import json
import pickle
import struct

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


def leaves(tree, wanted):
    """Where ``tree`` holds what is ``wanted``: owner and key."""
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
        if wanted(value):
            yield tree, key
        if isinstance(value, dict | list):
            yield from leaves(value, wanted)


def is_float(value):
    return isinstance(value, float)


def told(tree, rest):
    """Like :func:`made_of`, with numbers as they are spelled: JSON reads 1e999 as infinity."""
    text = json.dumps(tree)
    for spelling in SPELLED:
        text = text.replace(f'"{spelling}"', spelling)
    return sealed(text.encode() + b"\n" + rest)


SPELLED = ("1e999", "-1e999", "1e-320", "0.0", "-1.0", "1e300")


def test_a_number_too_large_is_refused_wherever_it_stands(chain):
    make, saved = chain
    count = len(list(leaves(parts_of(saved)[0]["standing"], is_float)))
    assert count >= 12
    for i in range(count):
        for spelling in ("1e999", "-1e999"):
            tree, rest = parts_of(saved)
            owner, key = list(leaves(tree["standing"], is_float))[i]
            owner[key] = spelling
            with pytest.raises(hb.ProblemError, match="not finite"):
                make().resume(told(tree, rest))


KEPT = {  # how -> what keeps a factorisation
    "native, small": (SYSTEMS["jax"], Q0, V0, {}),
    "host, dense": (SYSTEMS["numpy"], Q0, V0, {}),
    **{
        f"chain, {engine} {kind}": (*(getattr(links, name) for name in ("system", "q0", "v0")), {"engine": engine, **how})
        for links in [hb.load_problem("planar_chain(n_links=5)")]
        for engine, kind, how in (
            ("native", "band", {}),
            ("host", "band", {"linsolver": "band"}),
            ("host", "sparse", {"linsolver": "sparse"}),
        )
    },
}
MATRIX = {"InverseFactor": "inverse", "DenseFactor": "lu", "BandFactor": "storage", "SpluFactor": "matrix"}


def forged(saved, change):
    """A checkpoint after ``change(factor, get, put)``; the arrays of a record are got and put by its names."""
    tree, rest = parts_of(saved)
    arrays, at = [], 0
    for kind, shape in tree["arrays"]:
        arrays.append(np.frombuffer(rest, kind, int(np.prod(shape)), at).reshape(shape).copy())
        at += arrays[-1].nbytes

    def get(record):
        return arrays[record["number"]]

    def put(record, value):
        arrays[record["number"]] = np.ascontiguousarray(value)

    change(tree["standing"]["state"]["factor"], get, put)
    tree["arrays"] = [[array.dtype.str, array.shape] for array in arrays]
    return made_of(tree, b"".join(array.tobytes() for array in arrays))


def scaled(name, by):
    def change(factor, get, put):
        record = factor[MATRIX[factor["type"]] if name == "matrix" else name]
        record = record.get("data", record)
        put(record, by * get(record))

    return change


def no_map(factor, get, put):
    maps = factor["maps"]
    if maps["type"] == "array":
        put(maps, 0.0 * get(maps))
    else:
        put(maps["data"], np.zeros(0))
        put(maps["indices"], np.zeros(0, dtype=np.int32))
        put(maps["indptr"], 0 * get(maps["indptr"]))


def full_maps(factor, get, put):
    maps = factor["maps"]
    if maps["type"] == "array":
        put(maps, 0.0 * get(maps))
        return
    rows, columns = get(maps["indptr"]).size - 1, maps["shape"][1]
    put(maps["data"], np.ones(rows * columns))
    put(maps["indices"], np.tile(np.arange(columns, dtype=np.int32), rows))
    put(maps["indptr"], columns * np.arange(rows + 1, dtype=np.int32))


def whole_numbers(factor, get, put):
    record = factor["maps"].get("data", factor["maps"])
    put(record, get(record).astype(np.int64))


def no_increments(factor, get, put):
    if factor["type"] == "DenseFactor":  # the upper factor
        put(factor["lu"], get(factor["lu"]) * (1.0 + 1e300 * np.triu(np.ones(get(factor["lu"]).shape))))
    else:  # storage of bands holds what divides
        scaled("matrix", 1e300 if factor["type"] == "SpluFactor" else 1e-300)(factor, get, put)


def with_field(**values):
    return lambda factor, get, put: factor.update(values)


FORGED = {
    "maps of zero": scaled("maps", 0.0),
    "maps without entries": no_map,
    "maps with more entries": full_maps,
    "maps of whole numbers": whole_numbers,
    "increments of zero": no_increments,
    "much roundoff": with_field(noise=[1e300, 1e300]),
    "no length": with_field(h=5e-324),
    "a short length": with_field(h=1e-18),
}


@pytest.mark.filterwarnings("ignore:the system is a NumpySystem")
@pytest.mark.parametrize("accuracy", ACCURACY)
@pytest.mark.parametrize("kept", KEPT)
def test_a_forged_factorisation_is_refused(kept, accuracy):
    """Newton's iteration believes the kept one: it would call any guess a solution."""
    system, q0, v0, how = KEPT[kept]
    solver = begun(system, accuracy, q0, v0, **how)
    for _ in range(5):
        assert solver.step() is Status.success
    saved = solver.checkpoint()
    HHT(system, **how).resume(forged(saved, lambda *_: None))
    accepted = []
    for name, change in FORGED.items():
        try:
            HHT(system, **how).resume(forged(saved, change))
        except hb.ProblemError:
            continue
        accepted.append(name)
    assert not accepted


def test_a_trial_that_the_users_functions_break_leaves_the_run_as_it_was():
    """What they raise is told by the step that meets it, not by ``resume``."""
    calls = []

    def force(t, q, v):
        calls.append(t)
        if len(calls) > limit:
            raise RuntimeError("broken")
        return np.array([0.0, -9.81])

    limit, system = 10**9, NumpySystem(**{**PENDULUM, "force": force})
    whole = begun(system)
    assert whole.step() is whole.step() is Status.success
    saved = whole.checkpoint()
    with pytest.warns(UserWarning, match="NumpySystem"):
        HHT(system).resume(saved)
    before = len(calls)
    other = HHT(system)
    with pytest.warns(UserWarning, match="NumpySystem"):
        other.resume(saved)
    needed, calls[:] = len(calls) - before, []
    limit = needed - 2
    parts = HHT(system)
    with pytest.warns(UserWarning, match="NumpySystem"):
        parts.resume(saved)
    assert len(calls) == limit + 1, "the trial was broken off"
    limit = 10**9
    assert stepped(parts, 10) == stepped(whole, 10)


def changed_shape(array, random):
    """Its dimensions anew, with the same product, or with another."""
    count = int(np.prod(array[1]))
    array[1] = [[count], [1, count], [count, 1], [], [0], [count, 0], [1, 1, count], [count + 1]][random.integers(8)]


def mutated(saved, random):
    """Well-formed JSON with another shape, another array, or another number somewhere."""
    tree, rest = parts_of(saved)
    kind = random.integers(4)
    if kind == 0:
        changed_shape(tree["arrays"][random.integers(len(tree["arrays"]))], random)
    elif kind == 1:  # one without numbers or with one may have any number of dimensions
        small = [array for array in tree["arrays"] if np.prod(array[1]) <= 1]
        array = small[random.integers(len(small))]
        array[1] = [1] * int(random.integers(4)) if np.prod(array[1]) else [0] * int(random.integers(1, 4))
    elif kind == 2:
        records = [owner for owner, key in leaves(tree["standing"], lambda value: True) if key == "number"]
        records[random.integers(len(records))]["number"] = int(random.integers(len(tree["arrays"])))
    else:
        places = list(leaves(tree["standing"], is_float))
        owner, key = places[random.integers(len(places))]
        owner[key] = SPELLED[random.integers(len(SPELLED))]
    return told(tree, rest)


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


NO_SHAPES = {
    "standing.tolerances.rtol": [0],
    "standing.last.t": [],
    "standing.state.earlier": [],
    "standing.state.factor.order.blocks": [],
}


@pytest.mark.parametrize("path", NO_SHAPES)
def test_an_array_of_no_shape_is_refused(path, chain):
    make, saved = chain
    tree, rest = parts_of(saved)
    tree["arrays"] += [["<i8" if "blocks" in path else "<f8", NO_SHAPES[path]]]
    set_at(tree, path, {"type": "array", "number": len(tree["arrays"]) - 1})
    with pytest.raises(hb.ProblemError, match="does not fit"):
        make().resume(made_of(tree, rest + bytes(8 * int(np.prod(NO_SHAPES[path])))))


def test_a_singular_matrix_for_superlu_is_refused():
    system, q0, v0, how = KEPT["chain, host sparse"]
    solver = begun(system, "constant", q0, v0, **how)
    assert solver.step() is Status.success
    with pytest.raises(hb.ProblemError, match="singular"):
        solver.resume(forged(solver.checkpoint(), scaled("matrix", 0.0)))
