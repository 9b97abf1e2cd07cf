"""Structures: phi is made of the right samples, orders are checked, parameters are named."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robust_filterpy.identification import AR, ARMA, ARMAX, ARX, FIR, BoxJenkins, LinearRegression, OutputError
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


def test_equation_13_phi_of_the_plant():
    phi = ARX(2, 3).regressors(u=[1.0, 2.0, 3.0, 4.0], y=[5.0, 6.0, 7.0, 8.0])
    np.testing.assert_array_equal(phi[3], [-7.0, -6.0, 3.0, 2.0, 1.0])


def test_linear_regression_takes_phi_as_it_is():
    phi = np.arange(6.0).reshape(3, 2)
    np.testing.assert_array_equal(LinearRegression(2).regressors(phi), phi)


def test_which_parts_must_be_stable():
    assert OutputError(2, 3).stable_parts == (slice(0, 2),)
    assert ARMAX(2, 3, 1).stable_parts == (slice(5, 6),)
    assert BoxJenkins(2, 1, 1, 2).stable_parts == (slice(2, 4), slice(4, 5))
    assert ARX(2, 3).stable_parts == FIR(2).stable_parts == ARMAX(2, 3, 0).stable_parts == ()


def test_a_structure_is_its_orders_and_says_how_it_was_made():
    made = [ARX(2, 2), OutputError(2, (1, 2)), ARMAX(1, 2, 3), FIR(2), BoxJenkins(2, 1, 1, 2), ARMA(1, 2), AR(3)]
    for structure in (*made, LinearRegression(2), Structure(1, 2, 1, 1, 2)):
        assert eval(repr(structure)) == structure == Structure(**structure.get_params())
    assert Structure(na=2, nb=2, form="ARX") == ARX(2, 2) != ARMAX(2, 2, 0)
    assert Structure(1, 1, 1, 1, 1).names == ("a1", "b1", "f1", "c1", "d1")


def test_names_follow_theta():
    assert ARMAX(1, (1, 2), 1).names == ("a1", "b1[0]", "b1[1]", "b2[1]", "c1")
    assert LinearRegression(2).names == ("theta1", "theta2")
    for structure in (ARX(2, 1), FIR((1, 2)), ARMAX(1, 0, 2), LinearRegression(3)):
        assert len(structure.names) == structure.n_theta


def test_structures_are_values():
    assert ARX(2, [1, 2], np.int64(0)) == ARX(2, (1, 2), 0) != ARX(2, (1, 2), 1)
    assert pickle.loads(pickle.dumps(OutputError(2, (1, 2)))) == OutputError(2, (1, 2))
    assert len({ARX(2, 2), ARX(2, 2, 1), FIR(2)}) == 2
    with pytest.raises(AttributeError):
        ARX(2, 2).na = 3


@pytest.mark.parametrize(("make", "error", "words"), [
    (lambda: ARX(-1, 2), ValueError, "na: expected an integer >= 0"),
    (lambda: ARX(1, -2), ValueError, "nb: expected"),
    (lambda: ARX(1, (1, -2)), ValueError, r"nb\[1\]"),
    (lambda: ARX(1, 1, nk=-1), ValueError, "nk: expected"),
    (lambda: ARX(0, 0), ValueError, "all zero"),
    (lambda: Structure(), ValueError, "all zero"),
    (lambda: Structure(nf=1), ValueError, "at least one b"),
    (lambda: Structure(na=1, form="AR(1)"), ValueError, "form: expected one of"),
    (lambda: ARMAX(0, 0, 0), ValueError, "all zero"),
    (lambda: FIR((0, 0)), ValueError, "all zero"),
    (lambda: ARX(1, ()), ValueError, "at least one input"),
    (lambda: OutputError(2, 0), ValueError, "at least one b"),
    (lambda: LinearRegression(0), ValueError, "n: expected"),
    (lambda: ARX(2.0, 1), TypeError, "na: expected an integer"),
    (lambda: ARX(2, True), TypeError, "nb"),
    (lambda: ARX(2, (1, 1), (1, 1, 1)), ValueError, "expected 2 delays"),
    (lambda: ARX(2, 1, (1, 1)), ValueError, "one delay"),
    (lambda: ARX(2, 1).regressors(u=[1.0]), ValueError, "y: expected a signal"),
    (lambda: ARX(2, 1).regressors(u=[1.0], y=[1.0, 2.0]), ValueError, "y: expected 1 samples"),
    (lambda: ARX(1, (1, 1)).regressors(u=np.zeros((2, 5)), y=np.zeros(2)), ValueError, "u: expected shape"),
    (lambda: ARX(1, (1, 1)).regressors(u=np.zeros((2, 5)), y=np.zeros(5)), ValueError, "u.T|samples"),
])  # fmt: skip
def test_bad_orders_and_signals_are_refused(make, error, words):
    with pytest.raises(error, match=words):
        make()


@settings(max_examples=200, deadline=None)
@given(st.lists(st.floats(-3, 3), min_size=1, max_size=6))
def test_stability_agrees_with_the_roots(coefficients):
    radius = np.abs(np.roots([1.0, *coefficients])).max(initial=0.0)
    if abs(radius - 1.0) > 1e-3:
        assert is_stable(coefficients) == (radius < 1.0)


def test_stability_of_nothing_and_of_nan():
    assert is_stable([])
    assert not is_stable([np.nan, 0.1])


def test_guard_halves_to_the_first_stable_point():
    old, new = np.array([-0.5, 1.0]), np.array([-4.5, 9.0])
    theta, event = restrained(new, old, [slice(0, 1)], "halve")
    # -4.5, -2.5, -1.5, -1 (on the circle), -.75
    assert event == 4
    np.testing.assert_allclose(theta, [-0.75, 1.5])


def test_guard_rejects_or_lets_pass():
    old, new = np.array([-0.5]), np.array([-4.5])
    theta, event = restrained(new, old, [slice(0, 1)], "reject")
    assert event == -1 and theta == old and theta is not old
    assert restrained(new, old, [slice(0, 1)], "none") == (new, 0)
