"""A bank of filters is a loop over filters."""

import numpy as np
import pytest
import support

from robust_filterpy import Huber, Linear, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.batch.bank import FilterBank
from robust_filterpy.correction import NotPositiveDefiniteError, SingularInnovationError
from robust_filterpy.influence import Hampel

INFLUENCES = [Huber(), Linear(), Hampel(), TukeyBiweight(), StudentT()]


def gappy(rng, *shape):
    z = 3.0 * rng.normal(size=shape)
    z[rng.random(shape) < 0.1] += 50.0
    z[rng.random(shape) < 0.3] = np.nan
    return z


def loop_over(bank, **choices):
    filters = []
    for s in range(bank.n):
        kf = RobustKalmanFilter(bank.dim_x, bank.dim_z, **choices)
        kf.x, kf.P = bank.x[s].copy(), bank.P[s].copy()
        for name in "FHQR":
            value = getattr(bank, name)
            setattr(kf, name, value if value.ndim == 2 else value[s])
        filters.append(kf)
    return filters


@pytest.mark.parametrize("grouping", ["component", "joint"])
@pytest.mark.parametrize("information", ["realized", "expected", "weight"])
@pytest.mark.parametrize("scaling", ["innovation", "unit", "bounded"])
@pytest.mark.parametrize("influence", INFLUENCES, ids=lambda f: type(f).__name__)
def test_bank_is_the_loop(influence, scaling, information, grouping):
    choices = {"influence": influence, "scaling": scaling, "information": information, "grouping": grouping}
    for n, m in [(3, 1), (4, 2), (4, 3)]:
        rng = np.random.default_rng(n + m)
        bank = FilterBank(3, n, m, **choices)
        bank.F, bank.Q, bank.H = 0.8 * np.eye(n) + 0.02, 0.01 * np.eye(n), 0.3 * rng.normal(size=(m, n))
        bank.R, bank.P = np.array([support.spd(rng, m) for _ in range(3)]), 0.1 * bank.P
        filters = loop_over(bank, **choices)
        for z in gappy(rng, 8, 3, m):
            bank.predict()
            bank.update(z)
            for s, kf in enumerate(filters):
                kf.predict()
                kf.update(z[s])
                for ours, theirs in [
                    (bank.x, kf.x), (bank.P, kf.P), (bank.weights, kf.weights), (bank.log_likelihood, kf.log_likelihood)
                ]:  # fmt: skip
                    np.testing.assert_allclose(np.ravel(ours[s]), np.ravel(theirs), rtol=1e-10, atol=1e-11)


def test_each_filter_may_have_its_own_matrices_and_input():
    rng = np.random.default_rng(5)
    bank = FilterBank(4, 2, 1)
    bank.F = np.array([support.stable(rng, 2) for _ in range(4)])
    bank.H, bank.Q = rng.normal(size=(4, 1, 2)), np.array([support.spd(rng, 2) for _ in range(4)])
    filters, B, u = loop_over(bank), rng.normal(size=(2, 1)), rng.normal(size=(4, 1))
    bank.predict(u, B)
    bank.update(np.array([[1.0], [np.nan], [1e9], [-1.0]]))
    for s, kf in enumerate(filters):
        kf.predict(u[s], B)
        kf.update([1.0, np.nan, 1e9, -1.0][s])
        np.testing.assert_allclose(bank.x[s], kf.x.ravel(), rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(bank.P[s], kf.P, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize(
    "spoil, match",
    [
        (lambda bank: bank.update(np.zeros(3)), r"z: expected shape .*use z\[:, None\]"),
        (lambda bank: setattr(bank, "R", None) or bank.update(np.zeros((3, 1))), "R: .*got None"),
        (lambda bank: setattr(bank, "F", None) or bank.predict(), "F: .*got None"),
        (lambda bank: bank.update(np.full((3, 1), np.inf)), "infinity"),
        (lambda bank: setattr(bank, "R", 5.0) or bank.update(np.zeros((3, 1))), "R: expected shape"),
        (lambda bank: setattr(bank, "R", -0.5 * np.eye(1)) or bank.update(np.zeros((3, 1))), "R: expected a positive"),
        (lambda bank: setattr(bank, "F", np.full((2, 2), np.nan)) or bank.predict(), "finite"),
    ],
)
def test_a_refused_call_changes_nothing(spoil, match):
    bank = FilterBank(3, 2, 1)
    bank.H = np.array([[1.0, 0.0]])
    x, P = bank.x.copy(), bank.P.copy()
    with pytest.raises((ValueError, np.linalg.LinAlgError), match=match):
        spoil(bank)
    np.testing.assert_array_equal(bank.x, x)
    np.testing.assert_array_equal(bank.P, P)


@pytest.mark.parametrize("spoilt", [0, 4, 6])
def test_an_error_names_the_filter(spoilt):
    bank = FilterBank(7, 3, 2)
    bank.R = np.tile(np.eye(2), (7, 1, 1))
    bank.P[spoilt] *= -100.0
    bank.H = np.eye(2, 3)
    with pytest.raises(SingularInnovationError, match=f"filter {spoilt}:"):
        bank.update(np.zeros((7, 2)))
    bank = FilterBank(7, 3, 2, scaling="unit")
    bank.P, bank.H = 0.01 * bank.P, np.eye(2, 3)
    bank.P[spoilt] = 10.0 * np.eye(3)
    with pytest.raises(NotPositiveDefiniteError, match=f"filter {spoilt}:"):
        bank.update(np.zeros((7, 2)))
    assert not bank.x.any()


@pytest.mark.parametrize("m", [1, 2, 3])
@pytest.mark.parametrize("own", [True, False])
@pytest.mark.parametrize("bad", ["negative", "NaN", "infinite", "asymmetric"])
def test_a_bad_R_is_refused_and_its_filters_named(m, own, bad):
    bank = FilterBank(5, 3, m)
    bank.H, bank.R = np.eye(m, 3), np.tile(np.eye(m), (5, 1, 1)) if own else np.eye(m)
    for R in bank.R[2::2] if own else [bank.R]:
        if bad == "asymmetric":
            R[0, -1] += 0.1 if m > 1 else -2.0
        else:
            R[-1, -1] = {"negative": -0.5, "NaN": np.nan, "infinite": np.inf}[bad]
    with pytest.raises(ValueError, match=r"^R: expected .*\(filter 2 and 1 more\)$" if own else r"^R: expected [^(]*$"):
        bank.update(np.ones((5, m)))
    assert not bank.x.any() and not bank.y.any()


def test_an_R_that_was_written_into_is_checked_again():
    bank = FilterBank(3, 2, 2)
    bank.update(np.ones((3, 2)))
    bank.R[1, 1] = -0.1
    with pytest.raises(ValueError, match="R: expected a positive semidefinite"):
        bank.update(np.ones((3, 2)))


def test_an_R_symmetric_but_for_rounding_is_taken():
    bank = FilterBank(2, 2, 2)
    bank.R = np.array([[2.0, 0.3], [0.3 + 1e-15, 1.0]])
    bank.update(np.ones((2, 2)))


def test_None_is_a_measurement_that_all_filters_miss():
    bank = FilterBank(3, 2, 2)
    bank.H, bank.x = np.eye(2), np.ones((3, 2))
    bank.update(None)
    np.testing.assert_array_equal(bank.x, np.ones((3, 2)))
    np.testing.assert_array_equal(bank.P, np.tile(np.eye(2), (3, 1, 1)))
    assert np.isnan(bank.weights).all() and not bank.log_likelihood.any()
