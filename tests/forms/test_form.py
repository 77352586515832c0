"""Packing, masks and refusals; what a system does not declare has no unknowns and is never called."""

import dataclasses

import numpy as np
import pytest

from hhtbench.lowering import derive
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.system import NumpySystem
from solvers.forms import FORMS, MASKED, make_form, refusal, underlying
from tests.forms.scenes import LINEAR_NUMPY, Linear
from tests.lowering.systems import (
    PENDULUM_NUMPY,
    RICH_NUMPY,
    RUBBING_NUMPY,
    SPRINGS_NUMPY,
    WHEEL_NUMPY,
    Massless,
    MasslessWheel,
    Rich,
    Springs,
    on_numpy,
    rich_force,
    rich_mass,
)

Q3, V3 = np.array([0.6, 0.8, 0.48]), np.array([0.8, -0.6, 0.28])
CONSTRAINED = ("index3", "index2", "ggl", "integrated")
MIXED = {  # unknowns of a system with n = 3, m = p = 1
    "index3": {"q": (0, 3), "v": (3, 6), "lam": (6, 7), "mu": (7, 8)},
    "index2": {"q": (0, 3), "v": (3, 6), "lam": (6, 7), "mu": (7, 8)},
    "ggl": {"q": (0, 3), "v": (3, 6), "lam": (6, 7), "mu": (7, 8), "eta": (8, 9)},
    "index1": {"q": (0, 3), "v": (3, 6), "lam": (6, 7), "mu": (7, 8)},
    "integrated": {"q": (0, 3), "v": (3, 6), "Lam": (6, 7), "Mu": (7, 8), "Eta": (8, 9)},
    "ode": {"q": (0, 3), "v": (3, 6)},
}


def dynamics_of(system, n=3):
    return derive(system, 0.2, Q3[:n], V3[:n])


def logged(system, n=3):
    """A NumPy system's dynamics and the list of names of its callbacks, in the order they are called."""
    names = []
    return dataclasses.replace(dynamics_of(system, n), on_call=names.append), names


def call_everything(form):
    y, yp = np.linspace(0.1, 0.9, form.size), np.linspace(0.2, 0.7, form.size)
    if form.kind == "ode":
        return form.rhs(0.2, y), form.rhs_jacobian(0.2, y)
    return form.residual(0.2, y, yp), form.jacobian(0.2, y, yp, 5.0)


@pytest.mark.parametrize("name", FORMS)
def test_blocks_of_a_mixed_system_fill_the_unknowns(name):
    form = make_form(name, dynamics_of(LINEAR_NUMPY))
    places = {block: (place.start, place.stop) for block, place in form.blocks.items()}
    assert places == MIXED[name]
    assert form.size == max(stop for _, stop in places.values())
    assert form.kind == ("ode" if name == "ode" else "dae")
    value, matrix = call_everything(form)
    assert value.shape == (form.size,)
    assert matrix.shape == (form.size, form.size)


@pytest.mark.parametrize("name", FORMS)
def test_multipliers_are_masked_and_not_differential_but_their_integrals_are(name):
    form = make_form(name, dynamics_of(LINEAR_NUMPY))
    expected = np.arange(form.size) >= 6 if name in ("index3", "index2", "ggl", "index1") else np.zeros(form.size, bool)
    np.testing.assert_array_equal(form.multipliers, expected)
    np.testing.assert_array_equal(form.differential, ~expected)


def test_a_velocity_without_mass_is_differential_only_where_its_rate_is_in_the_equations():
    third = {name: make_form(name, dynamics_of(Massless())).differential[5] for name in ("index2", "ggl", "index1")}
    assert third == {"index2": False, "ggl": False, "index1": True}


def test_differential_entries_are_those_that_the_derivative_acts_on():
    """Columns of dF/dy' = (J(c) - J(0)) / c, at a point where no entry is zero by chance."""
    for system in (RICH_NUMPY, WHEEL_NUMPY):
        for name in ("index2", "ggl", "index1", "integrated"):
            form = make_form(name, dynamics_of(system))
            y, yp = np.linspace(0.3, 0.9, form.size), np.linspace(0.2, 0.7, form.size)
            acts = np.abs(form.jacobian(0.2, y, yp, 7.0) - form.jacobian(0.2, y, yp, 0.0)).max(axis=0) > 1e-9
            np.testing.assert_array_equal(acts, form.differential, err_msg=name)


def test_velocity_constraints_alone_have_no_eta():
    dynamics = dynamics_of(MasslessWheel())
    assert list(make_form("ggl", dynamics).blocks) == ["q", "v", "mu"]
    assert list(make_form("integrated", dynamics).blocks) == ["q", "v", "Mu"]


@pytest.mark.parametrize("name", FORMS)
def test_start_packs_the_state_and_state_gives_it_back_without_copies(name):
    form = make_form(name, dynamics_of(LINEAR_NUMPY))
    vdot, lam, mu = np.array([1.0, 2.0, 3.0]), np.array([4.0]), np.array([5.0])
    start = form.start(Q3, V3, vdot, lam, mu)
    multipliers = np.concatenate([lam, mu, np.zeros(1)])[: form.size - 6]
    rates = name == "integrated"
    np.testing.assert_array_equal(start.y, np.concatenate([Q3, V3, np.zeros(3) if rates else multipliers]))
    np.testing.assert_array_equal(start.yp, np.concatenate([V3, vdot, multipliers if rates else 0 * multipliers]))
    rows = np.stack([start.y, 2 * start.y])
    for packed, factor in ((start.y, 1.0), (rows, np.array([[1.0], [2.0]]))):
        state = form.state(packed)
        np.testing.assert_array_equal(state.q, factor * Q3)
        np.testing.assert_array_equal(state.v, factor * V3)
        assert np.shares_memory(state.q, packed)
        assert np.shares_memory(state.v, packed)


def test_error_weights_keep_multipliers_out_of_the_error_test():
    form = make_form("ggl", dynamics_of(LINEAR_NUMPY))
    masked = [MASKED] * 3
    np.testing.assert_array_equal(form.error_weights(1e-6), [1e-6] * 6 + masked)
    np.testing.assert_array_equal(form.error_weights([1.0, 2.0, 3.0]), [1, 2, 3, 1, 2, 3, *masked])
    np.testing.assert_array_equal(form.error_weights(np.arange(1.0, 7.0)), [1, 2, 3, 4, 5, 6, *masked])
    integrated = make_form("integrated", dynamics_of(LINEAR_NUMPY))
    np.testing.assert_array_equal(integrated.error_weights([1.0, 2.0, 3.0]), [1, 2, 3, 1, 2, 3, 3, 3, 3])
    with pytest.raises(ProblemError, match=r"\(3,\) or \(6,\); got shape \(2,\)"):
        form.error_weights([1.0, 2.0])


def test_points_are_counted_by_the_form_or_by_the_callbacks_never_by_both():
    assert make_form("index2", dynamics_of(Rich())).points == 1
    for name in FORMS:
        dynamics, names = logged(LINEAR_NUMPY)
        form = make_form(name, dynamics)
        y, yp = np.linspace(0.1, 0.9, form.size), np.linspace(0.2, 0.7, form.size)
        (form.rhs(0.2, y) if name == "ode" else form.residual(0.2, y, yp))
        assert (form.points, names.count("force")) == (0, 1)


def test_unconstrained_systems_have_no_multiplier_code(monkeypatch):
    def forbidden(*_):
        raise AssertionError("KKT code called")

    monkeypatch.setattr(underlying, "kkt_terms", forbidden)
    heavy = NumpySystem(force=on_numpy(rich_force), mass_matrix=on_numpy(rich_mass))
    cases = ((SPRINGS_NUMPY, 2, {"force"}), (heavy, 3, {"force", "mass_matrix"}))
    for system, n, allowed in cases:
        for name in ("index1", "ode"):
            dynamics, names = logged(system, n)
            form = make_form(name, dynamics)
            call_everything(form)
            assert (list(form.blocks), form.size) == (["q", "v"], 2 * n)
            assert set(names) == allowed
    call_everything(make_form("ode", dynamics_of(Springs(), 2)))


def test_only_the_declared_kind_of_constraint_is_called():
    for name in FORMS:
        dynamics, names = logged(PENDULUM_NUMPY, 2)
        call_everything(make_form(name, dynamics))
        assert set(names) == {"force", "constraint"}, name
    for name in ("index2", "ggl", "index1", "integrated", "ode"):
        dynamics, names = logged(WHEEL_NUMPY)
        call_everything(make_form(name, dynamics))
        assert set(names) == {"force", "velocity_constraint"}, name


def test_index_two_and_below_do_not_evaluate_what_they_do_not_contain():
    """With every derivative declared, g itself is called by the forms that hold it and by no other."""
    system = NumpySystem(
        force=lambda t, q, v: np.array([0.0, -9.81]),
        force_jacobians=lambda t, q, v: (None, None),
        constraint=lambda t, q: np.array([(q @ q - 1) / 2]),
        constraint_jacobian=lambda t, q: q[None, :],
        constraint_time_derivative=lambda t, q: np.zeros(1),
        constraint_acceleration=lambda t, q, v: np.array([v @ v]),
        reaction_jacobians=lambda t, q, lam: (-lam[0] * np.eye(2), -q[:, None]),
    )
    holds = {}
    for name in FORMS:
        dynamics, names = logged(system, 2)
        call_everything(make_form(name, dynamics))
        holds[name] = ("constraint" in names, "constraint_acceleration" in names)
    assert [name for name in FORMS if holds[name][0]] == ["index3", "ggl", "integrated"]
    assert [name for name in FORMS if holds[name][1]] == ["index1", "ode"]


@pytest.mark.parametrize("name", [name for name in CONSTRAINED if name != "ggl"])
def test_a_form_about_constraints_declines_a_system_without(name):
    dynamics = dynamics_of(SPRINGS_NUMPY, 2)
    assert "the system has none; take form=index1" in refusal(name, dynamics.structure)
    with pytest.raises(ProblemError, match=f"the form {name} treats constraints"):
        make_form(name, dynamics)


def test_index3_declines_velocity_constraints_alone():
    dynamics = dynamics_of(WHEEL_NUMPY)
    assert "take the form index2" in refusal("index3", dynamics.structure)
    assert [name for name in FORMS if refusal(name, dynamics.structure) is None] == list(FORMS[1:])


def test_the_ode_alone_declines_a_nonlinear_reaction():
    for system in (Rich(), RICH_NUMPY):
        structure = dynamics_of(system).structure
        assert [name for name in FORMS if refusal(name, structure) is not None] == ["ode"]
        assert "nonlinear" in refusal("ode", structure)
    assert refusal("ode", dynamics_of(Linear()).structure) is None
    assert refusal("ode", dynamics_of(RUBBING_NUMPY, 2).structure) is None  # friction, which is solved by iteration


def test_the_ode_declines_a_constant_singular_mass_without_constraints():
    system = NumpySystem(mass_matrix=np.array([1.0, 0.0]), force=lambda t, q, v: -q)
    with pytest.raises(ProblemError, match="singular and no constraint determines"):
        make_form("ode", dynamics_of(system, 2))
    assert make_form("index1", dynamics_of(system, 2)).differential.tolist() == [True, True, True, False]


def test_unknown_names_are_answered_with_the_closest():
    dynamics = dynamics_of(SPRINGS_NUMPY, 2)
    for call in (lambda: make_form("index4", dynamics), lambda: refusal("index4", dynamics.structure)):
        with pytest.raises(ProblemError, match=r"no form 'index4'\. Did you mean index\d\? Forms: index3, index2, ggl"):
            call()


def test_functions_of_the_other_kind_say_so():
    with pytest.raises(ProblemError, match="call rhs"):
        make_form("ode", dynamics_of(SPRINGS_NUMPY, 2)).residual(0.0, Q3, Q3)
    with pytest.raises(ProblemError, match="call residual"):
        make_form("index1", dynamics_of(SPRINGS_NUMPY, 2)).rhs(0.0, Q3)
