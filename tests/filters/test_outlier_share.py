"""A filter whose model is wrong says so once; one whose sensor sometimes lies does not."""

import copy
import pickle
import warnings

import numpy as np
import pytest
import support
from filterpy.kalman import IMMEstimator
from support import recovering

from robust_filterpy import (
    ARX,
    AdaptiveKalmanFilter,
    ParameterTracker,
    RobustKalmanFilter,
    RobustUnscentedKalmanFilter,
    StudentT,
    TukeyBiweight,
    _warning,
)
from robust_filterpy.filters import OutlierShareWarning
from robust_filterpy.identification import LostTrackerWarning
from robust_filterpy.influence import Linear


#: Only this scaling expects a share of clipped innovations; a learnt spread follows what is told too small.
class ByS(RobustKalmanFilter):
    def __init__(self, *dims, **options):
        super().__init__(*dims, **{"scaling": "innovation", **options})


@pytest.fixture(autouse=True)
def anew(monkeypatch):
    """Forget what has been warned of."""
    monkeypatch.setattr(_warning, "_said", set())


def run(problem, zs, **options):
    """Run a filter and return the messages of its warnings."""
    kf = support.make(RobustKalmanFilter, problem, **options)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for z in zs:
            kf.predict()
            kf.update(z)
    return [str(one.message) for one in caught if one.category is OutlierShareWarning]


def recordings(dims, factor=1.0, contamination=0.0):
    problem = support.random_problem(10001, *dims)
    zs, _ = support.simulate(problem, 400, seed=10001, contamination=contamination, size=30.0)
    return support.with_(problem, R=problem.R * factor, Q=problem.Q * factor), zs


@pytest.mark.parametrize("options", [{}, {"grouping": "joint"}, {"influence": TukeyBiweight()}])
@pytest.mark.parametrize("dims", [(2, 1), (4, 2), (7, 4)])
def test_noises_ten_thousand_times_too_small_are_told_once(dims, options):
    told = run(*recordings(dims, 1e-4), **options)
    assert len(told) == 1 and "psi expects" in told[0] and "diagnose" in told[0] and "is too small" in told[0]


def test_a_learnt_spread_needs_no_telling():
    assert not run(*recordings((4, 2), 1e-4), scaling="learnt")


# Whitening spreads an outlier of one sensor over all: of four that each lie in 30 % of samples, one does in 76 %.
@pytest.mark.parametrize("dims, contamination", [((2, 1), 0.0), ((2, 1), 0.3), ((4, 2), 0.15), ((7, 4), 0.05)])
def test_outliers_are_not(dims, contamination):
    assert not run(*recordings(dims, 1.0, contamination))
    assert not run(*recordings(dims, 1e-4, contamination), influence=Linear())


@pytest.mark.parametrize("q", [1e-6, 1e-4])
@pytest.mark.parametrize("seed", range(10_010, 10_015))
def test_R_a_thousand_times_too_small_is_told_within_200_samples_at_the_line_of_the_user(seed, q):
    kf = ByS(2, 1)
    kf.F, kf.H, kf.Q, kf.R = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), q * np.eye(2), 1e-3 * np.eye(1)
    with pytest.warns(OutlierShareWarning) as caught:
        for z in np.random.default_rng(seed).normal(size=200):
            kf.predict()
            kf.update(z)
    assert [one.filename for one in caught] == [__file__]


@pytest.mark.parametrize("update_first", [False, True])
@pytest.mark.parametrize(
    "options", [{}, {"grouping": "joint"}, {"influence": TukeyBiweight()}, {"influence": StudentT(5.0)}]
)
@pytest.mark.parametrize("dims", [(2, 1), (4, 2)])
def test_batch_filter_tells_what_steps_tell_and_keeps_quiet_where_they_do(dims, options, update_first):
    for factor, told in ((1e-4, 1), (1.0, 0)):
        problem, zs = recordings(dims, factor, 0.1)
        for gap in (slice(0, 0), slice(5, None, 4)):
            zs[gap] = np.nan
            _warning._said.clear()
            kf = support.make(ByS, problem, **options)
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                kf.batch_filter(zs, update_first=update_first)
            assert [one.filename for one in caught if one.category is OutlierShareWarning] == [__file__] * told


@pytest.mark.parametrize("r, curve, cause", [(1e-3, 0.0, "R is too small"), (1.0, 0.02, "Q is too small")])
def test_batch_filter_says_which_noise_is_too_small(r, curve, cause):
    kf = ByS(2, 1)
    kf.F, kf.H, kf.Q, kf.R = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), 1e-7 * np.eye(2), r * np.eye(1)
    zs = np.random.default_rng(10_020).normal(size=600) + curve * np.arange(600.0) ** 2
    with pytest.warns(OutlierShareWarning, match=cause):
        kf.batch_filter(zs)


def test_batch_filter_whose_warning_is_an_error_changes_nothing():
    problem, zs = recordings((2, 1), 1e-4)
    kf = support.make(ByS, problem)
    before = support.snapshot(kf)
    with warnings.catch_warnings():
        warnings.simplefilter("error", OutlierShareWarning)
        with pytest.raises(OutlierShareWarning):
            kf.batch_filter(zs)
    support.assert_unchanged(before, kf)


def test_filterpy_s_own_loop_is_not_the_line_of_the_user():
    problem, zs = recordings((2, 1), 1e-4)
    models = [support.make(ByS, problem) for _ in range(2)]
    imm = IMMEstimator(models, [0.5, 0.5], 0.5 * np.ones((2, 2)))
    with pytest.warns(OutlierShareWarning) as caught:
        for z in zs:
            imm.predict()
            imm.update(z)
    assert [one.filename for one in caught] == [__file__]


def test_the_count_survives_copies():
    problem, zs = recordings((2, 1), 1e-4)
    kf = support.make(RobustKalmanFilter, problem)
    with pytest.warns(OutlierShareWarning):
        for k, z in enumerate(zs):
            if k % 50 == 0:
                kf = pickle.loads(pickle.dumps(copy.deepcopy(kf)))
            kf.predict()
            kf.update(z)


def test_a_sigma_point_filter_says_it_too():
    from filterpy.kalman import MerweScaledSigmaPoints

    kf = RobustUnscentedKalmanFilter(
        1, 1, 1.0, lambda x: x, lambda x, dt: x, MerweScaledSigmaPoints(1, 0.5, 2.0, 2.0), scaling="innovation"
    )
    kf.Q, kf.R = 1e-6 * np.eye(1), 1e-6 * np.eye(1)
    rng = np.random.default_rng(0)
    with pytest.warns(OutlierShareWarning, match="Unscented"):
        for _ in range(300):
            kf.predict()
            kf.update(rng.normal(size=1))


@pytest.mark.parametrize("filter", [None, ByS, ByS(2, 1)], ids=["own", "class", "object"])
def test_a_tracker_speaks_for_its_filter(filter):
    rng = np.random.default_rng(0)
    tracker = ParameterTracker(ARX(1, 1), filter=filter, P=100.0, Q=0.0, R=1e-6, start=0)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for y, u in rng.normal(size=(600, 2)):
            tracker.update(y, u)
    assert [one.category for one in caught] == [LostTrackerWarning]
    assert "ParameterTracker" in str(caught[0].message)


def walker(cls, factor, steps=800, seed=10002):
    """Return the error in m of the end of a walk among six far anchors, R told as so many times too small."""
    rng, angles = np.random.default_rng(seed), np.arange(6) * np.pi / 3
    F, G, H = np.kron(np.eye(2), [[1.0, 0.1], [0.0, 1.0]]), np.kron(np.eye(2), [[0.005], [0.1]]), np.zeros((6, 4))
    H[:, 0], H[:, 2] = np.cos(angles), np.sin(angles)
    kf, x, errors = cls(4, 6), np.zeros(4), []
    kf.F, kf.H, kf.Q, kf.R = F, H, G @ G.T, 0.01 / factor * np.eye(6)
    for _ in range(steps):
        x = F @ x + G @ rng.normal(size=2)
        kf.predict()
        kf.update(H @ x + 0.1 * rng.normal(size=6) + (rng.random(6) < 0.1) * rng.exponential(2.0, 6))
        errors.append(np.hypot(*(np.ravel(kf.x) - x)[::2]))
    return np.sqrt(np.mean(np.square(errors[steps // 2 :])))


# Sensor by sensor the one that fits best comes first, and R a hundred times too small loses less than it did.
@pytest.mark.parametrize(("factor", "share"), [(100.0, 0.2), pytest.param(1e4, 0.1, marks=pytest.mark.nightly)])
def test_a_recovering_filter_that_is_told_a_tiny_R_says_that_it_is_lost_and_an_adaptive_one_is_not(factor, share):
    # One that is lost depends on the last bit: of one walk its error is anything.
    with pytest.warns(OutlierShareWarning, match="RobustKalmanFilter"):
        lost = np.median([walker(recovering, factor, 400, 20000 + seed) for seed in range(9)])
    with warnings.catch_warnings():
        warnings.simplefilter("error", OutlierShareWarning)
        learnt = walker(AdaptiveKalmanFilter, factor)
    assert learnt < min(1.2 * walker(AdaptiveKalmanFilter, 1.0), share * lost)
