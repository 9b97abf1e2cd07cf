"""What a filter says of its sensors and its model: once, at the user's line, and of nothing that is in order.

That a sensor is stuck, that a filter which learns its noise lags behind, that more is clipped than psi expects.
"""

import copy
import pickle
import warnings

import numpy as np
import pandas as pd
import pytest
import support
from filterpy.common import Saver
from filterpy.kalman import IMMEstimator
from recordings import silence
from support import through

from robust_filterpy import (
    ARX,
    AdaptiveKalmanFilter,
    Contaminated,
    ParameterTracker,
    RobustKalmanFilter,
    RobustUnscentedKalmanFilter,
    StudentT,
    TukeyBiweight,
    _warning,
    filter_series,
)
from robust_filterpy.filters import CorrelatedInnovationsWarning, OutlierShareWarning, StuckSensorWarning
from robust_filterpy.fleet import FilterModel, step
from robust_filterpy.identification import LostTrackerWarning
from robust_filterpy.influence import Linear


@pytest.fixture(autouse=True)
def anew(monkeypatch):
    """Forget what has been warned of."""
    monkeypatch.setattr(_warning, "_said", set())


def said(call, kind):
    """Return the warnings of a kind that a call gives."""
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        call()
    return [one for one in given if one.category is kind]


class Comparable(AdaptiveKalmanFilter):
    """A filter that two of can be compared, and that is not hashable therefore."""

    def __eq__(self, other):
        return bool((self.x == other.x).all())


def level(m=1, cls=AdaptiveKalmanFilter, q=1e-4, **options):
    """A filter of a level that hardly moves."""
    return support.of_matrices(cls, 1.0, np.ones((m, 1)), q, **options)


# A sensor that is stuck.


def sticking(m=1):
    """Return readings of a level, the last sensor's stuck far off from 140 to 160."""
    zs = np.random.default_rng(1).normal(size=(200, m))
    zs[140:160, -1] = 50.0
    return zs


def in_series(zs):
    m, known = zs.shape[1], level(zs.shape[1])
    known.batch_filter(zs[:100])
    filter_series(
        np.stack([zs[:100], zs[100:]]), [[1.0]], np.ones((m, 1)), [[1e-4]], np.eye(m), [0.0], [[1.0]],
        noise="learnt", process="scales", learnt=known.learnt,
    )  # fmt: skip


# On a slope, for which Q is far too small.
SLOPE = 3.0 * np.arange(60)[:, None] + np.random.default_rng(1).normal(size=(60, 1))
WAYS = {
    "online": lambda zs: through(level(zs.shape[1]), zs),
    "by the definition": lambda zs: through(level(zs.shape[1], grouping=(tuple(range(zs.shape[1])),)), zs),
    "recording": lambda zs: level(zs.shape[1]).batch_filter(zs),
    "with a saver": lambda zs: (lambda kf: kf.batch_filter(zs, saver=Saver(kf)))(level(zs.shape[1])),
    "series": in_series,
    "noise given": lambda zs: through(level(cls=RobustKalmanFilter, noise=Contaminated(0.1, 10.0)), zs),
    "extended": lambda zs: through(level(cls=support.Extended, noise="learnt"), zs),
    "unscented": lambda zs: through(level(cls=RobustUnscentedKalmanFilter, noise="learnt"), zs),
    "not hashable": lambda zs: through(level(cls=Comparable), zs),
}

#: Where the users of these call the filter: a loop of this file's, or of support's.
LINE = {way: __file__ if way in ("recording", "with a saver", "series") else support.__file__ for way in WAYS}


@pytest.mark.parametrize("way, m", [
    *((way, m) for way in ("online", "by the definition", "recording", "with a saver", "series") for m in (1, 3)),
    ("extended", 1), ("unscented", 1), ("not hashable", 1),
])  # fmt: skip
def test_a_stuck_sensor_is_named_once_at_the_users_line(way, m):
    (one,) = said(lambda: WAYS[way](sticking(m)), StuckSensorWarning)
    assert f"sensor {m - 1} is stuck" in str(one.message) and one.filename == LINE[way]
    assert ("step 141" in str(one.message)) == (way == "recording")
    assert ("series 1" in str(one.message)) == (way == "series")


@pytest.mark.filterwarnings("error::robust_filterpy.filters.StuckSensorWarning")
def test_nothing_is_said_of_sensors_in_coarse_steps_counters_held_samples_and_simulations():
    rng = np.random.default_rng(2)
    v, walk = rng.normal(size=1000), np.cumsum(0.3 * rng.normal(size=1000))
    jumps = np.repeat(rng.normal(size=10) * 40.0, 100)
    quiet = {
        "white": v, "walk": walk + v, "jumps": jumps + v, "coarse": np.round(walk + v),
        "coarse jumps": np.round(jumps + v), "fine steps": np.round(walk + v, 1),
        "twice": np.repeat((walk + v)[::2], 2), "counter": np.cumsum(rng.poisson(2.0, 1000)), "no noise": jumps,
        "sine": np.sin(np.arange(1000) / 50.0), "outliers": walk + np.where(rng.random(1000) < 0.1, 10.0, 1.0) * v,
    }  # fmt: skip
    for zs in quiet.values():
        through(level(), zs)


def test_series_and_keys_say_it_once_with_how_many_there_are():
    zs = np.random.default_rng(4).normal(size=(5, 60, 1))
    zs[2:4, 40:44] = -9999.0
    model = [*[np.eye(1)] * 4, np.zeros(1), np.eye(1)]
    for noise in (None, "learnt"):
        with pytest.warns(StuckSensorWarning, match="filter_series: series 2 and 1 more of 5: sensor 0"):
            filter_series(zs, *model, noise=noise)
    with silence(StuckSensorWarning):
        filter_series(zs[:2], *model)
        # What psi refuses is not stuck.
        filter_series(zs, *model, influence=TukeyBiweight(), scaling="innovation")


@pytest.mark.parametrize("noise", [None, "learnt"])
def test_a_stream_says_it_once_for_each_key(noise):
    model, states, found = FilterModel(level(cls=RobustKalmanFilter, q=0.01, noise=noise)), None, []
    zs = np.random.default_rng(5).normal(size=(3, 60))
    zs[0, 30:33] = zs[0, 50:53] = zs[2, 45:48] = -9999.0
    for k in range(0, 60, 5):
        table = pd.DataFrame({"device": np.repeat(["a", "b", "c"], 5), "z0": zs[:, k : k + 5].ravel()})
        with warnings.catch_warnings(record=True) as given:
            warnings.simplefilter("always", StuckSensorWarning)
            states, _ = step(model, states, table, key="device")
        found += [(k, str(w.message)[:18]) for w in given]
    # What is learned of noise forgets that it has been said.
    again = [(50, "step: key 'a' of 3")] if noise else []
    assert found == [(30, "step: key 'a' of 3"), (45, "step: key 'c' of 3"), *again]


# A filter that lags behind.


@pytest.mark.parametrize("way", [way for way in WAYS if way != "series"])
def test_a_filter_that_lags_says_so_at_the_users_line_once_for_each_kind(way):
    (one,) = said(lambda: [WAYS[way](SLOPE) for _ in range(3)], CorrelatedInnovationsWarning)
    assert "sensor 0" in str(one.message) and "the estimate lags behind" in str(one.message)
    assert one.filename == LINE[way]
    if way == "online":
        (other,) = said(lambda: WAYS[way](SLOPE + [[0.0, 0.1]]), CorrelatedInnovationsWarning)
        assert "of sensor 0" in str(other.message) or "of sensor 1" in str(other.message)
        # One that takes Q as given is shown what doubts it.
        trusting_one = level(cls=RobustKalmanFilter, noise="learnt", process="given")
        (trusting,) = said(lambda: through(trusting_one, SLOPE), type(other.message))
        assert ['process="scales"' in str(each.message) for each in (one, other, trusting)] == [False, False, True]


@pytest.mark.filterwarnings("error::robust_filterpy.filters.CorrelatedInnovationsWarning")
@pytest.mark.parametrize("seed", range(6))
def test_nothing_is_said_of_a_filter_that_follows(seed):
    rng = np.random.default_rng([seed, 3])
    # Share of outliers, size of the noise, its color, a jump and where the level starts.
    for share, size, color, jump, start in (
        (0, 1, 0, 0, 0), (0.3, 5, 0, 0, 75), (0, 0.2, 0.5, 0, 0), (0.1, 1, 0, 100, 0),
    ):  # fmt: skip
        x, noise = np.cumsum(0.1 * rng.normal(size=600)) + start, rng.normal(size=600)
        for k in range(1, 600):
            noise[k] = color * noise[k - 1] + np.sqrt(1 - color**2) * noise[k]
        x[300:] += jump
        zs = x + size * noise * np.where(rng.random(600) < share, 10.0, 1.0)
        through(level(q=0.01), zs)
        level(q=0.01).batch_filter(zs)


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
        through(kf, zs)


# More is clipped than psi expects.


#: Only this scaling expects a share of clipped innovations; a learnt spread follows what is given too small.
class ByS(RobustKalmanFilter):
    def __init__(self, *dims, **options):
        super().__init__(*dims, **{"scaling": "innovation", **options})


def recordings(dims, factor=1.0, contamination=0.0):
    problem = support.random_problem(10001, *dims)
    zs, _ = support.simulate(problem, 400, seed=10001, contamination=contamination, size=30.0)
    return support.with_(problem, R=problem.R * factor, Q=problem.Q * factor), zs


# Whitening spreads an outlier of one sensor over all: of four that each lie in 30 % of samples, one does in 76 %.
@pytest.mark.filterwarnings("error::robust_filterpy.filters.OutlierShareWarning")
@pytest.mark.parametrize("dims, contamination", [((2, 1), 0.0), ((2, 1), 0.3), ((4, 2), 0.15), ((7, 4), 0.05)])
def test_outliers_are_not_and_a_learnt_spread_follows_small_noises(dims, contamination):
    for factor, options in ((1.0, {}), (1e-4, {"influence": Linear()}), (1e-4, {"scaling": "learnt"})):
        problem, zs = recordings(dims, factor, contamination)
        through(support.make(ByS, problem, **options), zs)


@pytest.mark.pairwise
@pytest.mark.parametrize("update_first", [False, True])
@pytest.mark.parametrize("options", [
    {}, {"grouping": "joint"}, {"influence": TukeyBiweight()}, {"influence": StudentT(5.0)},
], ids=range(4))  # fmt: skip
@pytest.mark.parametrize("dims", [(2, 1), (4, 2), (7, 4)])
def test_noises_ten_thousand_times_too_small_are_said_once_by_steps_and_by_batch_filter(dims, options, update_first):
    """At the user's line, also of a recording with gaps; of noises as they are nothing is said."""
    for factor, often in ((1e-4, 1), (1.0, 0)):
        problem, zs = recordings(dims, factor, 0.05)
        for gap in (slice(0, 0), slice(5, None, 4)):
            zs[gap] = np.nan
            for line, call in (
                (support.__file__, lambda kf: through(kf, zs)),  # noqa: B023
                (__file__, lambda kf: kf.batch_filter(zs, update_first=update_first)),  # noqa: B023
            ):
                _warning._said.clear()
                kf = support.make(ByS, problem, **options)
                given = said(lambda call=call, kf=kf: call(kf), OutlierShareWarning)
                assert [one.filename for one in given] == [line] * often
                assert all(words in str(one.message) for one in given for words in ("psi expects", "is too small"))


@pytest.mark.parametrize("r, curve, cause", [(1e-3, 0.0, "R is too small"), (1.0, 0.02, "Q is too small")])
def test_batch_filter_says_which_noise_is_too_small(r, curve, cause):
    kf = support.mover(ByS, r, P=1.0)
    kf.Q = 1e-7 * np.eye(2)
    with pytest.warns(OutlierShareWarning, match=cause):
        kf.batch_filter(np.random.default_rng(10_020).normal(size=600) + curve * np.arange(600.0) ** 2)


def test_batch_filter_whose_warning_is_an_error_changes_nothing():
    problem, zs = recordings((2, 1), 1e-4)
    kf = support.make(ByS, problem)
    before = support.snapshot(kf)
    with silence(OutlierShareWarning), pytest.raises(OutlierShareWarning):
        kf.batch_filter(zs)
    support.assert_unchanged(before, kf)


def test_filterpy_s_own_loop_is_not_the_line_of_the_user_and_copies_go_on_counting():
    problem, zs = recordings((2, 1), 1e-4)
    imm = IMMEstimator([support.make(ByS, problem) for _ in range(2)], [0.5, 0.5], 0.5 * np.ones((2, 2)))
    with pytest.warns(OutlierShareWarning) as caught:
        for k, z in enumerate(zs):
            if k % 50 == 0:
                imm.filters = [pickle.loads(pickle.dumps(copy.deepcopy(kf))) for kf in imm.filters]
            imm.predict()
            imm.update(z)
    assert [one.filename for one in caught] == [__file__]


def test_a_sigma_point_filter_says_it_too():
    kf = support.of_matrices(RobustUnscentedKalmanFilter, 1.0, [[1.0]], 1e-6, 1e-6, scaling="innovation")
    with pytest.warns(OutlierShareWarning, match="Unscented"):
        through(kf, np.random.default_rng(0).normal(size=(300, 1)))


@pytest.mark.parametrize("filter", [None, ByS, ByS(2, 1)], ids=["own", "class", "object"])
def test_a_tracker_speaks_for_its_filter(filter):
    tracker = ParameterTracker(ARX(1, 1), filter=filter, P=100.0, Q=0.0, R=1e-6, start=0)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for y, u in np.random.default_rng(0).normal(size=(600, 2)):
            tracker.update(y, u)
    assert [one.category for one in caught] == [LostTrackerWarning]
    assert "ParameterTracker" in str(caught[0].message)
