"""The influence functions, their maps and E[psi']; oracles are statsmodels' norms, scipy.stats and quadrature."""

import copy
import pickle
from itertools import pairwise

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from statsmodels.robust import norms

from robust_filterpy import Contaminated, Huber, RobustKalmanFilter, StudentT, TukeyBiweight, filter_series
from robust_filterpy.correction.options import Choices
from robust_filterpy.influence import Hampel, Linear
from robust_filterpy.influence.information import expected_information

OURS = [Huber(), Huber(0.5), Linear(), Hampel(), Hampel(1.5, 3.5, 8.0), TukeyBiweight(), StudentT(), StudentT(1.5)]
PAIRS = [
    (Huber(1.345), norms.HuberT(1.345)), (Huber(0.7), norms.HuberT(0.7)), (Linear(), norms.LeastSquares()),
    (Hampel(2.0, 4.0, 8.0), norms.Hampel(2.0, 4.0, 8.0)), (Hampel(1.0, 1.5, 9.0), norms.Hampel(1.0, 1.5, 9.0)),
    (TukeyBiweight(4.685), norms.TukeyBiweight(4.685)), (TukeyBiweight(2.0), norms.TukeyBiweight(2.0)),
]  # fmt: skip
FUNCTIONS = ("rho", "psi", "psi_deriv", "weights")
ids = repr

# Irrational spacing, so that no point falls on a kink.
GRID = np.linspace(-12.0, 12.0, 801) + 1e-3 * np.pi


@pytest.mark.parametrize("ours, theirs", PAIRS, ids=ids)
@pytest.mark.parametrize("function", ["rho", "psi", "psi_deriv", "weights"])
def test_agrees_with_statsmodels(ours, theirs, function):
    np.testing.assert_allclose(getattr(ours, function)(GRID), getattr(theirs, function)(GRID), rtol=1e-12, atol=1e-12)


EVERY = pytest.mark.parametrize("influence", [*OURS, Contaminated(0.1, 10.0), Contaminated(0.3, 5.0)], ids=ids)


def integral(function, e, breaks):
    """The integral of `function` from 0 to e, by adaptive quadrature between the breaks."""
    inside = [b for b in breaks if 0 < b < e]
    return quad(function, 0, e, points=inside or None, limit=200)[0]


def corners(influence):
    """Where psi' jumps."""
    if isinstance(influence, norms.TukeyBiweight):
        return [influence.c]
    return [] if isinstance(influence, Contaminated) else [*influence.corners]


@EVERY
def test_rho_is_the_integral_of_psi_and_psi_that_of_its_derivative(influence):
    for e in (0.3, 1.2, 1.7, 3.0, 5.0, 11.0):
        for whole, slope in ((influence.rho, influence.psi), (influence.psi, influence.psi_deriv)):
            np.testing.assert_allclose(whole(e), integral(slope, e, corners(influence)), rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize(
    "influence", [Huber(0.5), Linear(), StudentT(4.0), Contaminated(0.1, 10.0), Contaminated(0.3, 5.0)], ids=ids
)
def test_the_density_that_a_psi_belongs_to_integrates_to_one(influence):
    edges = [0.0, 1.0, 3.0, 10.0, 30.0, 100.0, np.inf]
    density = lambda e: np.exp(-influence.rho(e) - influence.log_normalizer(1))  # noqa: E731
    assert 2.0 * sum(quad(density, a, b)[0] for a, b in pairwise(edges)) == pytest.approx(1.0, abs=1e-6)


def test_corners_are_where_the_derivative_of_psi_jumps():
    for influence in OURS:
        jumps = np.abs(np.diff(influence.psi_deriv(np.arange(1e-3, 12.0, 2e-3)))) > 0.05
        there = {getattr(influence, name) for name in ("a", "b", "c", "threshold") if hasattr(influence, name)}
        assert set(influence.corners) == {kink for kink in there if np.isfinite(kink)}
        assert isinstance(influence, (TukeyBiweight, StudentT)) or jumps.sum() == len(influence.corners)


@EVERY
def test_it_is_even_weighs_by_psi_over_e_and_is_the_kalman_filter_at_zero(influence):
    np.testing.assert_allclose(influence.weights(GRID), influence.psi(GRID) / GRID, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(influence.psi(-GRID), -influence.psi(GRID), rtol=1e-14)
    for even in (influence.rho, influence.psi_deriv, influence.weights):
        np.testing.assert_allclose(even(-GRID), even(GRID), rtol=1e-14)
    if not isinstance(influence, Contaminated):
        assert [getattr(influence, name)(0.0) for name in FUNCTIONS] == [0, 0, 1, 1]


@pytest.mark.parametrize("influence", OURS, ids=ids)
def test_shape_is_kept_and_integers_become_floats(influence):
    for name in FUNCTIONS:
        for shape in ((), (1,), (3,), (3, 1), (2, 3)):
            value = getattr(influence, name)(np.full(shape, 3))
            assert np.shape(value) == shape
            np.testing.assert_allclose(value, getattr(influence, name)(np.full(shape, 3.0)), rtol=1e-15)


@EVERY
@given(e=st.one_of(st.floats(-1e300, 1e300), st.sampled_from([0.0, -1e160, 1e300])))
def test_psi_is_bounded_and_nothing_overflows_however_large_the_residual(influence, e):
    bound = [getattr(influence, name, 0) + (name == "df") for name in ("threshold", "a", "df", "scale_ratio")]
    with np.errstate(all="raise", under="ignore"):
        assert influence == Linear() or abs(influence.psi(e)) <= max(bound)
        assert 0 <= influence.weights(e) <= 1 and influence.psi_deriv(e) <= 1
    with np.errstate(all="ignore"):
        assert not np.isnan(influence.rho(e))


@given(st.floats(1e-6, 0.99))
def test_contamination_solves_hubers_equation_and_comes_back(contamination):
    huber, normal = Huber.from_contamination(contamination), scipy.stats.norm
    odds = 2 * normal.pdf(huber.threshold) / huber.threshold - 2 * normal.sf(huber.threshold)
    assert odds == pytest.approx(contamination / (1 - contamination), rel=1e-8)
    assert huber.contamination == pytest.approx(contamination, rel=1e-8)


def test_an_infinite_threshold_is_no_contamination():
    assert Huber(np.inf).contamination == 0
    assert Huber.from_contamination(0).threshold == np.inf
    np.testing.assert_array_equal(Huber(np.inf).psi(GRID), GRID)
    np.testing.assert_array_equal(Huber(np.inf).weights(GRID), np.ones_like(GRID))


@pytest.mark.parametrize("df", [1.0, 3.0, 4.0, 10.0])
def test_student_is_the_score_of_its_density_whose_fisher_information_is_expected(df):
    assert expected_information(StudentT(df)) == pytest.approx(df / (df + 3), rel=1e-7)
    density, h = scipy.stats.t(df, scale=np.sqrt((df + 1.0) / df)), 1e-6
    score = -(density.logpdf(GRID + h) - density.logpdf(GRID - h)) / (2 * h)
    np.testing.assert_allclose(StudentT(df).psi(GRID), score, atol=1e-8)


@pytest.mark.parametrize("influence", [
    Linear(), Huber(np.inf), TukeyBiweight(4.685), norms.TukeyBiweight(4.685), Hampel(2.0, 4.0, 8.0),
], ids=ids)  # fmt: skip
def test_expected_information_under_the_normal_distribution(influence):
    edges = np.unique([-20.0, 20.0, *(side * x for x in corners(influence) if x < 20 for side in (-1, 1))])
    slope = lambda e: influence.psi_deriv(e) * scipy.stats.norm.pdf(e)  # noqa: E731
    expected = sum(quad(slope, a, b, limit=400)[0] for a, b in pairwise(edges))
    assert expected_information(influence) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("influence", OURS, ids=ids)
def test_is_a_value(influence):
    for twin in (copy.copy(influence), copy.deepcopy(influence), pickle.loads(pickle.dumps(influence))):
        assert twin == influence
        assert hash(twin) == hash(influence)
    assert eval(repr(influence)) == influence and influence != Huber(7.0)
    for name in ("threshold", "a", "df", "new"):
        if hasattr(influence, name) or name == "new":
            with pytest.raises((AttributeError, TypeError)):
                setattr(influence, name, 1.0)


@pytest.mark.parametrize("build", [
    lambda: Huber(0), lambda: Huber(-1.0), lambda: Huber(np.nan), lambda: Huber("1"), lambda: Huber([1.0, 2.0]),
    lambda: Huber.from_contamination(1.0), lambda: Huber.from_contamination(-0.1),
    lambda: Huber.from_contamination(np.nan), lambda: Huber.from_contamination("a"), lambda: TukeyBiweight(0.0),
    lambda: TukeyBiweight(-2.0), lambda: TukeyBiweight(np.nan), lambda: StudentT(0.0), lambda: StudentT(-1.0),
    lambda: StudentT(np.nan), lambda: Hampel(4.0, 2.0, 8.0), lambda: Hampel(2.0, 9.0, 8.0),
    lambda: Hampel(0.0, 4.0, 8.0), lambda: Hampel(-1.0, 4.0, 8.0), lambda: Hampel(np.nan, 4.0, 8.0),
])  # fmt: skip
def test_refuses(build):
    with pytest.raises((ValueError, TypeError), match="expected"):
        build()


class Halved:
    """A psi to be mixed in before a class of the package's own."""

    def psi(self, e):
        return 0.5 * super().psi(e)

    def psi_deriv(self, e):
        return 0.5 * super().psi_deriv(e)


class Mine(Halved, Huber):
    pass


class Again(Mine):
    pass


class Unchanged(Huber, Halved):
    pass


def test_a_psi_of_a_subclass_or_of_a_mixin_is_the_one_that_is_applied():
    assert Choices(Unchanged()).kernel_psi == Choices(Huber()).kernel_psi
    for influence in (Mine(), Mine(2.0), Again()):
        psi, D, *_ = Choices(influence).influence_on(np.array([1.0]), 1.0)
        assert psi == [0.5] and D == [0.5]
        kf, whole = RobustKalmanFilter(1, 1, influence=influence), RobustKalmanFilter(1, 1, influence=Linear())
        for f in (kf, whole):
            f.update(1.0)
        assert kf.x[0, 0] == pytest.approx(0.5 * whole.x[0, 0])


class Steeper(Huber):
    """A density of its own, and the parent's psi."""

    def rho(self, e):
        return 2.0 * super().rho(e)


def test_a_rho_overridden_in_a_subclass_is_the_one_of_the_likelihood():
    assert Choices(Steeper()).kernel_psi is None
    kf = RobustKalmanFilter(1, 1, influence=Steeper(0.5))
    kf.F, kf.H, total = np.eye(1), np.eye(1), 0.0
    model, zs = (kf.F, kf.H, kf.Q, kf.R, kf.x.ravel(), kf.P), np.random.default_rng(0).normal(size=(2, 200, 1))
    for z in zs[0]:
        kf.predict()
        kf.update(z)
        total += kf.log_likelihood
    assert filter_series(zs, *model, influence=Steeper(0.5)).log_likelihood[0] == pytest.approx(total, rel=1e-9)
