"""That a filter which learns its noise lags behind is said once, at the user's line, and of no filter that does not."""

import copy
import warnings

import numpy as np
import pytest
from filterpy.common import Saver
from filterpy.kalman import MerweScaledSigmaPoints

from robust_filterpy import (
    AdaptiveKalmanFilter,
    Contaminated,
    RobustKalmanFilter,
    RobustUnscentedKalmanFilter,
    _warning,
)
from robust_filterpy.filters import CorrelatedInnovationsWarning


@pytest.fixture(autouse=True)
def nobody_told(monkeypatch):
    monkeypatch.setattr(_warning, "_said", set())


def level(m=1, **options):
    """Return a filter of a level, Q far smaller than a slope needs."""
    kf = AdaptiveKalmanFilter(1, m, **options)
    kf.H, kf.Q, kf.R = np.ones((m, 1)), 1e-4 * np.eye(1), np.eye(m)
    return kf


def on_a_slope(rng, steps=60, m=1):
    return 3.0 * np.arange(steps)[:, None] + rng.normal(size=(steps, m))


def online(kf, zs):
    for z in zs:
        kf.predict()
        kf.update(z)


def unscented(zs):
    points = MerweScaledSigmaPoints(1, 0.1, 2.0, 2.0)
    kf = RobustUnscentedKalmanFilter(1, 1, 1.0, lambda x: x, lambda x, dt: x, points, noise="learnt")
    kf.Q *= 1e-4
    online(kf, zs)


def told():
    kf = RobustKalmanFilter(1, 1, noise=Contaminated(0.1, 10.0))
    kf.H, kf.Q = np.ones((1, 1)), 1e-4 * np.eye(1)
    return kf


def with_saver(zs):
    kf = level()
    saver = Saver(kf)
    kf.batch_filter(zs, saver=saver)


WAYS = {
    "online": lambda zs: online(level(), zs),
    "by the definition": lambda zs: online(level(grouping=((0,),)), zs),
    "recording": lambda zs: level().batch_filter(zs),
    "recording with a saver": with_saver,
    "told": lambda zs: online(told(), zs),
    "unscented": unscented,
}


def said(call):
    """Return the warnings of this kind that a call gives."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        call()
    return [w for w in found if w.category is CorrelatedInnovationsWarning]


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
def test_a_filter_that_lags_says_so_at_the_users_line(way):
    (one,) = said(lambda: way(on_a_slope(np.random.default_rng(1))))
    assert "sensor 0" in str(one.message) and "the estimate lags behind" in str(one.message)
    assert one.filename == __file__


def test_once_for_each_kind_of_filter():
    zs = np.random.default_rng(1)
    first, second = on_a_slope(zs), on_a_slope(zs, m=2)
    assert len(said(lambda: [online(level(), first) for _ in range(3)])) == 1
    (other,) = said(lambda: [online(level(2), second) for _ in range(3)])
    assert "of sensor 0" in str(other.message) or "of sensor 1" in str(other.message)


@pytest.mark.filterwarnings("error::robust_filterpy.filters.CorrelatedInnovationsWarning")
@pytest.mark.parametrize("make", [level, lambda: level(grouping=((0,),))], ids=["kernel", "definition"])
def test_where_the_word_is_an_error_the_call_is_refused_and_may_be_made_again(make):
    kf, zs = make(), on_a_slope(np.random.default_rng(1))
    online(kf, zs[:56])
    kf.predict()
    before = copy.deepcopy(kf)
    for _ in range(2):
        with pytest.raises(CorrelatedInnovationsWarning):
            kf.update(zs[56])
        assert kf.x.tobytes() == before.x.tobytes() and kf.learnt.tobytes() == before.learnt.tobytes()


@pytest.mark.filterwarnings("error::robust_filterpy.filters.CorrelatedInnovationsWarning")
@pytest.mark.parametrize("seed", range(6))
def test_nothing_is_said_of_a_filter_that_follows(seed):
    rng = np.random.default_rng([seed, 3])
    kinds = {
        "clean": (0, 1, 0, 0, 0), "wild": (0.3, 5, 0, 0, 75), "coloured": (0, 0.2, 0.5, 0, 0),
        "jump": (0.1, 1, 0, 100, 0),
    }  # fmt: skip
    for share, size, colour, jump, start in kinds.values():
        x, noise = np.cumsum(0.1 * rng.normal(size=600)) + start, rng.normal(size=600)
        for k in range(1, 600):
            noise[k] = colour * noise[k - 1] + np.sqrt(1 - colour**2) * noise[k]
        x[300:] += jump
        zs = x + size * noise * np.where(rng.random(600) < share, 10.0, 1.0)
        for way in (online, lambda kf, zs: kf.batch_filter(zs)):
            kf = level()
            kf.Q[0, 0] = 0.01
            way(kf, zs)


@pytest.mark.filterwarnings("error::robust_filterpy.filters.CorrelatedInnovationsWarning")
@pytest.mark.parametrize("seed", range(8))
def test_nothing_is_said_of_a_signal_without_noise_that_the_model_follows(seed):
    """A start leaves innovations of one sign, that fall; rounding has a sign too."""
    rng = np.random.default_rng([seed, 11])
    for n in (1, 2, 3):
        kf = AdaptiveKalmanFilter(n, 1) if seed % 2 else RobustKalmanFilter(n, 1, noise="learnt")
        kf.F = np.triu(np.ones((n, n))) if n < 3 else np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
        kf.H, unit = np.eye(1, n), 10.0 ** rng.uniform(-6, 6)
        kf.P, kf.R = np.eye(n) * 10.0 ** rng.uniform(0, 4) * unit**2, np.eye(1) * unit**2
        kf.Q = np.eye(n) * unit**2 * rng.choice([0.0, 1e-6, 1e-2, 1.0])
        x, zs = rng.normal(size=n) * unit * 10.0 ** -np.arange(n), []
        for _ in range(600):
            zs.append(x[:1])
            x = kf.F @ x
        copy.deepcopy(kf).batch_filter(zs)
        online(kf, zs)
