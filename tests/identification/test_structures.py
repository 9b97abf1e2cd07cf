"""Structures: phi is made of the right samples, orders are checked, parameters are named."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings import assert_refused

from robust_filterpy.identification import AR, ARMA, ARMAX, ARX, FIR, BoxJenkins, LinearRegression, OutputError
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.identification.models.regressor import is_stable, restrained
from robust_filterpy.identification.models.structures import Structure


def shifted(signal, lag):
    """signal(k - lag), 0 before the start, one sample at a time."""
    return np.array([signal[k - lag] if k - lag >= 0 else 0.0 for k in range(len(signal))])


@settings(max_examples=60, deadline=None)
@given(
    na=st.integers(0, 4), nc=st.integers(0, 3), nb=st.lists(st.integers(0, 3), min_size=1, max_size=3),
    nk=st.integers(0, 3), length=st.integers(1, 9),
)  # fmt: skip
def test_rows_of_phi_are_shifted_data(na, nc, nb, nk, length):
    if na + nc + sum(nb) == 0:
        return
    rng = np.random.default_rng(1)
    u, y, r = rng.normal(size=(length, len(nb))), rng.normal(size=length), rng.normal(size=length)
    delays = tuple(nk + i for i in range(len(nb)))
    phi = ARMAX(na, tuple(nb), nc, delays).regressors(u, y, r)
    expected = [-shifted(y, j) for j in range(1, na + 1)]
    for i, n in enumerate(nb):
        expected += [shifted(u[:, i], delays[i] + j) for j in range(n)]
    expected += [shifted(r, j) for j in range(1, nc + 1)]
    np.testing.assert_array_equal(phi, np.transpose(expected))


def test_which_parts_must_be_stable():
    assert OutputError(2, 3).stable_parts == (slice(0, 2),)
    assert ARMAX(2, 3, 1).stable_parts == (slice(5, 6),)
    assert BoxJenkins(2, 1, 1, 2).stable_parts == (slice(2, 4), slice(4, 5))
    assert ARX(2, 3).stable_parts == FIR(2).stable_parts == ARMAX(2, 3, 0).stable_parts == ()


def test_a_structure_is_its_orders_and_says_how_it_was_made():
    made = [ARX(2, 2), OutputError(2, (1, 2)), ARMAX(1, 2, 3), FIR(2), BoxJenkins(2, 1, 1, 2), ARMA(1, 2), AR(3)]
    summed = [ARX(2, 1, integrated=True), FIR(2, integrated=True), AR(1, integrated=True)]
    assert all(one.integrated and one.nd == 1 for one in summed) and summed[0].names == ("a1", "a2", "b1", "d1")
    assert not any(one.integrated for one in (ARX(2, 1), Structure(2, 1, nd=1)))
    for structure in (*made, *summed, LinearRegression(2), Structure(1, 2, 1, 1, 2)):
        assert eval(repr(structure)) == structure
    assert Structure(na=2, nb=2, form="ARX") == ARX(2, 2) != ARMAX(2, 2, 0)
    assert Structure(1, 1, 1, 1, 1).names == ("a1", "b1", "f1", "c1", "d1")
    assert ARMAX(1, (1, 2), 1).names == ("a1", "b1[0]", "b1[1]", "b2[1]", "c1")
    assert LinearRegression(2).names == ("theta1", "theta2")


def test_structures_are_values():
    assert ARX(2, [1, 2], np.int64(0)) == ARX(2, (1, 2), 0) != ARX(2, (1, 2), 1)
    assert pickle.loads(pickle.dumps(OutputError(2, (1, 2)))) == OutputError(2, (1, 2))
    assert len({ARX(2, 2), ARX(2, 2, 1), FIR(2)}) == 2
    with pytest.raises(AttributeError):
        ARX(2, 2).na = 3


def test_bad_orders_and_signals_are_refused_by_name():
    nothing = [-1, 2.0]
    assert_refused(ARX, {"na": 2, "nb": 1}, {"na": nothing, "nb": [-2, (1, -2), True, ()], "nk": [-1, (1, 1)]})
    assert_refused(ARX, {"na": 2, "nb": (1, 1)}, {"nk": [(1, 1, 1)]})
    assert_refused(BoxJenkins, {"nb": 1, "nc": 1, "nd": 1, "nf": 1}, {"nb": [0], "nc": nothing, "nd": nothing})
    assert_refused(LinearRegression, {"n": 1}, {"n": [0]})
    assert_refused(AR, {"na": 1}, {"na": [0]})
    assert_refused(Structure, {"na": 1}, {"form": ["AR(1)"]})
    assert_refused(ARX(2, 1).regressors, {"u": [1.0], "y": [1.0]}, {"y": [None, [1.0, 2.0]], "u": [np.zeros((1, 5))]})


@pytest.mark.parametrize(("make", "words"), [
    (lambda: ARX(0, 0), "all zero"),
    (lambda: Structure(), "all zero"),
    (lambda: ARX(2, 2, 1, 3), "integrated: expected True or False"),
    (lambda: ARMAX(0, 0, 0), "all zero"),
    (lambda: ARMA(0, 0), "all zero"),
    (lambda: FIR((0, 0)), "all zero"),
    (lambda: Structure(nf=1), "at least one b"),
    (lambda: OutputError(2, 0), "at least one b"),
    (lambda: BoxJenkins(0, 1, 1, 1), "without input use ARMA"),
    (lambda: BoxJenkins(2, 1, 1, 2).regressors([1.0], [1.0]), "use identify"),
])  # fmt: skip
def test_what_is_no_structure_is_refused(make, words):
    with pytest.raises((ValueError, TypeError), match=words):
        make()


@settings(max_examples=200, deadline=None)
@given(st.lists(st.floats(-3, 3), max_size=6))
def test_stability_agrees_with_the_roots(coefficients):
    radius = np.abs(np.roots([1.0, *coefficients])).max(initial=0.0)
    if abs(radius - 1.0) > 1e-3:
        assert is_stable(coefficients) == (radius < 1.0)
    assert not is_stable([np.nan, *coefficients])


def test_guard_halves_to_the_first_stable_point_rejects_or_lets_pass():
    old, new, parts = np.array([-0.5, 1.0]), np.array([-4.5, 9.0]), [slice(0, 1)]
    theta, event = restrained(new, old, parts, "halve")
    # -4.5, -2.5, -1.5, -1 (on the circle), -.75
    assert event == 4
    np.testing.assert_allclose(theta, [-0.75, 1.5])
    theta, event = restrained(new, old, parts, "reject")
    assert event == -1 and (theta == old).all() and theta is not old
    theta, event = restrained(new, old, parts, "none")
    assert event == 0 and theta is new


# One predictor for every structure: its residuals are those of the definitions, its derivatives of differences.


STRUCTURES = [
    ARX(2, 2), ARX(2, 0), OutputError(2, (1, 2), nk=(1, 3)), OutputError(3, 1, nk=0), ARMAX(1, 2, 3, nk=0),
    ARMAX(2, 0, 1), FIR((2, 0, 1)), LinearRegression(2), AR(2), ARMA(2, 1), BoxJenkins((2, 1), 1, 2, 2, nk=(0, 2)),
    BoxJenkins(1, 2, 0, 0), Structure(na=2, nb=2, nc=2, nd=2, nf=1),
]  # fmt: skip


def recorded(structure, length=60, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=length) + 3.0, rng.normal(size=(length, structure.n_inputs))


@pytest.mark.parametrize("offset", [True, False])
@pytest.mark.parametrize("structure", STRUCTURES, ids=str)
def test_the_jacobian_is_the_derivative_of_the_residuals(structure, offset):
    y, u = recorded(structure)
    model = PolynomialModel(structure, y, u, offset)
    p = 0.2 * np.random.default_rng(1).normal(size=model.n)
    differences = [(model.residuals(p + h) - model.residuals(p - h)) / 2e-6 for h in 1e-6 * np.eye(model.n)]
    np.testing.assert_allclose(model.jacobian(p), np.transpose(differences), atol=1e-8)
