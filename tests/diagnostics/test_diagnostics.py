"""A diagnosis names the true cause of a broken set-up, and finds nothing in a healthy one."""

import functools
import itertools
import time

import numpy as np
import pytest
from filterpy.common import Saver
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter
from scipy import stats
from statsmodels.stats.diagnostic import acorr_ljungbox
from support import by_night, of_matrices, predict_and_update, states

from robust_filterpy import (
    AdaptiveKalmanFilter,
    Contaminated,
    Huber,
    Learnt,
    RobustExtendedKalmanFilter,
    RobustKalmanFilter,
)
from robust_filterpy.diagnostics import diagnose
from robust_filterpy.diagnostics import recording as statistics
from robust_filterpy.identification import ARX, ParameterTracker
from robust_filterpy.influence import Linear

N = 500
DT = 0.5
F = np.array([[1.0, DT], [0.0, 1.0]])
Q = 0.05 * np.array([[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
H = np.array([[1.0, 0.0], [0.0, 1.0]])
R = np.diag([0.3, 0.1])


def world(seed, sensors=2, contamination=0.05, memory=0.0, coupling=0.0, Q=Q, jump=0.0):
    """Draw a moving point and its position (and velocity) with outliers."""
    rng = np.random.default_rng(seed)
    w = np.vstack([np.zeros(2), rng.normal(size=(N - 1, 2)) @ np.linalg.cholesky(Q).T])
    w[300, 0] += jump
    x = states(F, w)
    noise = rng.normal(size=(N, 2)) @ np.linalg.cholesky([[1.0, coupling], [coupling, 1.0]]).T
    for k in range(1, N):
        noise[k] = memory * noise[k - 1] + np.sqrt(1 - memory**2) * noise[k]
    noise[rng.random((N, 2)) < contamination] *= 10.0
    return x, (x @ H.T + noise * np.sqrt(np.diag(R)))[:, :sensors]


def robust(sensors=2, R_factor=1.0, Q_factor=1.0, H=H, cls=RobustKalmanFilter, **choices):
    R_ = (R_factor * R)[:sensors, :sensors]
    return of_matrices(cls, F, H[:sensors], Q_factor * Q, R_, np.diag([0.3, 0.1]), **choices)


def altered(alter, **options):
    """A set-up whose measurements are not those of the model."""

    def setup(seed):
        z = world(seed, **options)[1]
        return robust(z.shape[1]), alter(z)

    return setup


def wrong(sensors=2, contamination=0.05, **changes):
    """A set-up whose R, Q or H is not that of the recording."""
    return lambda seed: (robust(sensors, **changes), world(seed, sensors, contamination)[1])


healthy, clean, R_too_large = wrong(), wrong(contamination=0.0), wrong(R_factor=25.0)
R_too_small = wrong(1, R_factor=1 / 9)


def shifted(z):
    return z + np.outer(np.arange(N) >= 200, [0.0, 4.0])


def frozen(z):
    z[100:160, 0] = z[100, 0]
    return z


#: Of each set-up: what makes it of a seed, the cause to be named first, and the sensor.
SETUPS = {
    "healthy": (healthy, None, None),
    "healthy, one sensor": (wrong(1), None, None),
    "clean": (clean, None, None),
    "R too small": (R_too_small, "R too small", None),
    "R too small, both": (wrong(R_factor=1 / 25), "R too small", None),
    "R too large": (R_too_large, "R too large", None),
    "R of one sensor too small": (wrong(R_factor=np.diag([1.0, 1 / 16])), "R too small", 1),
    "Q too small": (wrong(Q_factor=1e-3), "Q too small", None),
    "Q too small, one sensor": (wrong(1, Q_factor=1e-3), "Q too small", None),
    "Q too large": (wrong(Q_factor=1e3), "Q too large", None),
    "R and Q too small": (wrong(R_factor=1 / 25, Q_factor=1 / 25), "R and Q too small", None),
    "wrong row of H": (wrong(H=np.array([[1.0, 0.0], [1.0, 0.0]])), "wrong H", 1),
    "a row of H that is 0": (wrong(H=np.diag([1.0, 0.0])), "H is 0", 1),
    # Which row has the wrong sign is a matter of the sign of the state.
    "wrong sign in H": (wrong(H=np.diag([1.0, -1.0])), "wrong H", None),
    "mm instead of m": (altered(lambda z: z * [1000.0, 1.0]), "lost units", 0),
    "km/h instead of m/s": (altered(lambda z: z * [1.0, 3.6]), "lost units", 1),
    "mm instead of m, one sensor": (altered(lambda z: z * 1000.0, sensors=1), "lost units", None),
    "one sensor shifts": (altered(shifted), "level shift", 1),
    "one sensor biased": (altered(lambda z: z + [0.0, 3.0]), "bias", 1),
    "state jumps": (altered(np.array, jump=30.0), "level shift", 0),
    "state jumps, one sensor": (altered(np.array, sensors=1, jump=30.0), "level shift", 0),
    "saturating sensor": (altered(lambda z: np.minimum(z, np.quantile(z, 0.7, axis=0))), "saturation", 0),
    "frozen sensor": (altered(frozen), "frozen sensor", 0),
    "correlated noise": (altered(np.array, memory=0.9), "correlated noise", None),
    "coupled noise": (altered(np.array, coupling=0.8), "coupled noise", None),
    "30 % outliers": (altered(np.array, contamination=0.3), "more outliers", None),
}


@functools.cache
def diagnosed(name, seed=0):
    return diagnose(*SETUPS[name][0](seed))


# What is found by day; R that is too small or too large is diagnosed below.
QUICK = (
    "healthy", "Q too small, one sensor", "wrong row of H", "a row of H that is 0", "mm instead of m, one sensor",
    "state jumps, one sensor", "saturating sensor", "frozen sensor", "correlated noise",
)  # fmt: skip


@pytest.mark.parametrize("seed, name", [
    *((0, name) for name in QUICK),
    *(pytest.param(seed, name, marks=pytest.mark.slow) for name in SETUPS for seed in range(5)),
])  # fmt: skip
def test_names_the_true_cause(seed, name):
    _, cause, sensor = SETUPS[name]
    d = diagnosed(name, seed)
    if cause is None:
        assert not d.findings and str(d).startswith("Nothing unusual")
    else:
        assert d.causes[:1] == (cause,), str(d)
        assert sensor is None or d.findings[0].sensor == sensor


def test_says_at_which_sample_a_sensor_shifts_though_the_filter_follows_it():
    finding = diagnosed("one sensor shifts", 4).findings[0]
    assert (finding.cause, finding.sensor) == ("level shift", 1) and abs(finding.value - 200.0) <= 1.0


def test_a_saver_and_filterpys_filter_are_diagnosed_in_words_with_the_factor_and_left_as_they_were():
    (kf, zs), expected = R_too_small(0), str(diagnosed("R too small"))
    assert expected.startswith("R is about ") and "times too small" in expected and "clips good data" in expected
    before = repr(kf)
    assert str(diagnose(kf, zs)) == expected and repr(kf) == before
    saver = Saver(kf)
    for z in zs:
        predict_and_update(kf, z)
        saver.save()
    assert str(diagnose(saver)) == expected
    saver.to_array()
    assert str(diagnose(saver)) == expected
    d = diagnose(robust(1, R_factor=1 / 25, cls=KalmanFilter), world(0, 1, contamination=0.0)[1])
    assert d.causes == ("R too small",)
    assert d.clipped.max() == 0.0


def test_missing_samples_change_no_verdict():
    kf, zs = R_too_large(0)
    zs[40:90] = np.nan
    zs[100:130, 1] = np.nan
    d = diagnose(kf, zs)
    assert d.causes == ("R too large",)
    assert d.observed.tolist() == [N - 50, N - 80]


@pytest.mark.parametrize("variance, cause", [
    (0.04, ()), (0.04 / 36, ("R too small",)), pytest.param(0.04 * 36, ("R too large",), marks=pytest.mark.nightly),
])  # fmt: skip
def test_a_trackers_run_is_diagnosed(variance, cause):
    rng = np.random.default_rng(2)
    u = rng.choice([-1.0, 1.0], N)
    y = np.zeros(N)
    for k in range(1, N):
        y[k] = 0.8 * y[k - 1] + u[k - 1] + 0.2 * rng.normal()
    tracker = ParameterTracker(ARX(1, 1), R=variance, start=0)
    d = diagnose(tracker, y, us=u)
    assert d.causes == cause
    assert (tracker.theta == 0.0).all()
    run = tracker.run(y, u)
    assert d.clipped[0] == pytest.approx(np.mean(run.weights < 1), abs=0.01)


def test_without_a_linear_model_the_innovations_are_judged():
    rng = np.random.default_rng(5)
    kf = of_matrices(ExtendedKalmanFilter, 1.0, [[1.0]], 0.01, 0.1, x=[[1.0]])
    saver, x = Saver(kf), 1.0
    for _ in range(N):
        x += 0.1 * rng.normal()
        kf.predict()
        z = np.array([[np.exp(0.1 * x) + 3.0 * rng.normal()]])
        kf.update(z, lambda x: 0.1 * np.exp(0.1 * x), lambda x: np.exp(0.1 * x))
        saver.save()
    d = diagnose(saver)
    assert d.causes[0] == "S too small"


@pytest.mark.parametrize("seed", by_night(range(3), 0))
def test_factor_of_R_is_found_within_a_third(seed):
    (finding,) = diagnosed("R too small", seed).findings
    assert 9 / 1.34 < finding.value < 9 * 1.34


@pytest.mark.parametrize("influence", by_night([Huber(1.345), Huber(2.5), Linear()], Huber(1.345)))
def test_figures_of_a_right_model_are_those_of_the_normal_distribution(influence):
    kf, zs = clean(1)
    # Where psi clips is known beforehand only by a given S.
    kf.influence, kf.scaling = influence, "innovation"
    d = diagnose(kf, zs)
    k = getattr(influence, "threshold", np.inf)
    expected = 2 * stats.norm.sf(k)
    np.testing.assert_allclose(d.clipped_expected[:, 0], expected)
    assert (np.abs(d.clipped - expected) < 5 * np.sqrt(0.25 / N)).all()
    assert (np.abs(d.scale - 1) < 5 * 1.17 / np.sqrt(N)).all()
    assert d.nis.lower < d.nis.mean < d.nis.upper
    k = min(k, 3.0)
    one = stats.truncnorm(-k, k).var()
    assert d.nis.expected == pytest.approx(2 * one)


def test_expected_nis_of_joint_clipping_is_that_of_truncated_chi_square():
    kf, zs = clean(2)
    kf.grouping, kf.scaling = "joint", "innovation"
    nis = diagnose(kf, zs[:100]).nis
    k = kf.influence.threshold
    draws = np.sum(np.random.default_rng(0).normal(size=(400000, 2)) ** 2, axis=1)
    inside = draws[draws <= k * k]
    assert nis.expected == pytest.approx(inside.mean(), abs=5 * inside.std() / np.sqrt(len(inside)))


def test_whiteness_is_statsmodels_test_of_the_cut_innovations(monkeypatch):
    e = np.random.default_rng(1).normal(size=300)
    e[1:] += 0.4 * e[:-1]
    r, p = statistics.whiteness(e)
    cut = np.clip(e / statistics.bulk(e)[0], -2, 2)
    assert p == pytest.approx(float(acorr_ljungbox(cut, lags=[10])["lb_pvalue"].iloc[0]))
    monkeypatch.setitem(__import__("sys").modules, "statsmodels.stats.diagnostic", None)
    assert statistics.whiteness(e) == pytest.approx((r, p))


def test_longest_run_of_random_events_is_below_the_expected_in_99_percent():
    rng = np.random.default_rng(8)
    runs = np.array([statistics.longest_run(rng.random(500) < 0.2) for _ in range(2000)])
    bound = statistics.expected_run(0.2, 500)
    assert np.mean(runs > bound) < 0.01 + 5 * np.sqrt(0.01 / 2000)
    assert np.mean(runs > bound - 2) > 0.01
    assert statistics.longest_run(np.array([0, 1, 1, 0, 1, 1, 1], bool)) == 3


@pytest.mark.parametrize(("call", "error", "match"), [
    (lambda: diagnose(3), TypeError, "source: expected a filter"),
    (lambda: diagnose(robust()), TypeError, "zs: expected the measurements"),
    (lambda: diagnose(RobustExtendedKalmanFilter(1, 1), [1.0]), TypeError, "linear filter, a Saver or a tracker"),
    (lambda: diagnose(robust(), []), ValueError, "zs: expected at least one"),
    (lambda: diagnose(Saver(robust())), ValueError, "saver: expected"),
    (lambda: diagnose(robust(), [[1.0, 2.0]], contamination=1.0), ValueError, "contamination"),
])  # fmt: skip
def test_what_cannot_be_diagnosed_is_said(call, error, match):
    with pytest.raises(error, match=match):
        call()


def test_a_recording_of_nothing_says_nothing():
    d = diagnose(robust(), [None] * 30)
    assert not d.findings and d.observed.tolist() == [0, 0]
    assert "Nothing was measured" in str(d)


@pytest.mark.parametrize("R, cause", [
    (1.0, ()), (100.0, ("R too large",)), pytest.param(0.01, ("R too small",), marks=pytest.mark.nightly),
])  # fmt: skip
def test_a_filter_that_learns_its_noise_is_diagnosed_by_the_R_that_it_was_given(R, cause):
    rng = np.random.default_rng(4)
    level = np.cumsum(0.3 * rng.normal(size=600))
    kf = of_matrices(AdaptiveKalmanFilter, 1.0, [[1.0]], 0.09, R)
    found = diagnose(kf, level + np.where(rng.random(600) < 0.1, 10.0, 1.0) * rng.normal(size=600))
    assert found.causes == cause
    # Learnt noise has no threshold, so that no share of clipped samples is known beforehand.
    assert np.isnan(found.clipped_expected).all() and "nan" not in str(found)


@pytest.mark.parametrize("share", by_night([0.02, 0.1], 0.1))
def test_noise_that_is_given_says_how_much_may_be_clipped(share):
    kf = robust(noise=Contaminated(share, 10.0))
    low, high = diagnose(kf, np.random.default_rng(5).normal(size=(300, 2))).clipped_expected.T
    np.testing.assert_allclose(high, (1.0 - share) * low + share)


def test_more_outliers_than_given_are_advised_on_in_the_words_of_the_filter():
    rng = np.random.default_rng(3)
    zs = np.cumsum(0.1 * rng.normal(size=600)) + np.where(rng.random(600) < 0.35, 15.0, 1.0) * rng.normal(size=600)

    def found(**noise):
        return diagnose(of_matrices(RobustKalmanFilter, 1.0, [[1.0]], 0.01, **noise), zs)

    assert "made for: about" in str(found()) and "Huber.from_contamination" in str(found())
    text = str(found(noise=Contaminated(0.05, 10.0)))
    assert "than noise= tells" in text and "Huber" not in text
    assert "more outliers" not in found(noise=Learnt()).causes


def test_a_long_diagnosis_says_what_it_is_at(monkeypatch, capsys):
    monkeypatch.setattr(time, "monotonic", itertools.count(0.0, 1.0).__next__)
    diagnose(*R_too_small(0))
    lines = capsys.readouterr().err.splitlines()
    assert lines and all(line.startswith("diagnose: ") for line in lines)
    assert any("models tried at once: " in line for line in lines)


@pytest.mark.parametrize("inner, found", [(19, 19.0), (18, None)])
def test_a_range_of_fewer_than_twenty_values_has_no_end_to_stick_at(inner, found):
    assert statistics.saturated(np.r_[np.arange(float(inner)), np.full(12, float(inner))]) == found
