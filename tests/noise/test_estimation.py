"""estimate_noise: scales come back whatever the share of outliers, and the likelihood is the noise-matched filter's."""

import pickle
from types import SimpleNamespace

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter
from support import by_night, draws, noise_given, of_matrices

from robust_filterpy import ARX, Contaminated, ParameterTracker, RobustKalmanFilter
from robust_filterpy.noise._problem import NoiseFit, descend, log_likelihoods, of_filter, valleys
from robust_filterpy.noise.estimation import estimate_noise

F = np.array([[1.0, 1.0], [0.0, 0.95]])
Q, R = np.diag([0.1, 0.05]), 2.0


def recording(seed, contamination, steps=2000, outlier=10.0):
    rng = np.random.default_rng(seed)
    x, zs = np.zeros(2), np.zeros(steps)
    for k in range(steps):
        x = F @ x + np.sqrt(np.diag(Q)) * rng.standard_normal(2)
        zs[k] = x[0] + np.sqrt(R) * rng.standard_normal() * (outlier if rng.random() < contamination else 1.0)
    return zs


def guess(kind=RobustKalmanFilter, scale_R=30.0, scale_Q=0.02):
    return of_matrices(kind, F, [[1.0, 0.0]], Q * scale_Q, R * scale_R)


def level(a=1.0, **matrices):
    """A filter of a state that forgets by a."""
    return of_matrices(RobustKalmanFilter, a, [[1.0]], **matrices)


def random_walk(seed, steps=600, a=1.0, q=0.5, sigma=1.0, contamination=0.0):
    """A state that forgets by a, and is read with outliers ten times as large."""
    rng, x, zs = np.random.default_rng(seed), 0.0, np.empty(steps)
    for k in range(steps):
        x = a * x + q * rng.standard_normal()
        zs[k] = x + sigma * rng.standard_normal() * (10.0 if rng.random() < contamination else 1.0)
    return zs


@draws(1, 2)
@pytest.mark.parametrize("contamination", by_night([0.0, 0.1, 0.2], 0.2))
def test_scales_come_back_within_ten_percent(contamination, draws):
    found = [estimate_noise(guess(), recording(seed, contamination)) for seed in range(draws)]
    wider = (2 / draws) ** 0.5
    assert np.mean([f.R[0, 0] for f in found]) / R == pytest.approx(1.0, abs=0.1 * wider)
    assert np.mean([f.Q[0, 0] for f in found]) / Q[0, 0] == pytest.approx(1.0, abs=0.1 * wider)
    assert np.mean([f.contamination for f in found]) == pytest.approx(contamination, abs=0.02 * wider)
    assert all(f.converged for f in found)
    if contamination:
        # What a normal likelihood makes of it.
        assert estimate_noise(guess(), recording(1, contamination, 1000), contamination=0.0).R[0, 0] > 4.0 * R


@pytest.mark.parametrize("start", by_night([(3.0, 3.0), (1e4, 1e-4), (0.4, 0.33), (1e-4, 1e4)], (1e4, 1e-4)), ids=repr)
def test_where_the_search_begins_does_not_matter(start):
    """An AR(1) state: R = 0 with many outliers is a maximum too, 5 to 60 nats below."""
    zs = random_walk(0, 400, 0.9, 1.0)
    one, other = (estimate_noise(level(0.9, R=r, Q=q, P=5.0), zs) for r, q in ((1.0, 1.0), start))
    assert other.log_likelihood == pytest.approx(one.log_likelihood, abs=0.01)
    assert other.R[0, 0] == pytest.approx(one.R[0, 0], rel=0.01) and other.converged
    assert 0.5 < other.R[0, 0] < 2.0
    # A grid of decades passed the valley of two noises that count alike, and ended 2.1 nats below.
    zs, none = random_walk(33, 60, 0.3, 1.0, 0.5, 0.1), np.zeros(1, dtype=int)
    costs = [
        NoiseFit(of_filter(level(0.3, R=r, Q=q, P=5.0), zs, *[None] * 5), none, none, (None, None)).ends().costs[0]
        for r, q in ((1.0, 1.0), (10.0**-2.5, 10.0**0.3))
    ]
    assert costs[1] == pytest.approx(costs[0], abs=0.01)


def test_the_lowest_of_several_valleys_is_found_within_limits():
    def cost(points):
        x, y = points.T
        return (x**2 - 4.0) ** 2 + x + (y - 0.5 * x) ** 4 + 0.01 * y**2

    lower, upper = np.array([-5.0, -0.5]), np.array([5.0, 5.0])
    starts = np.array([[3.0, 3.0], [-3.0, 2.0], [0.0, 0.0]])
    found = descend(cost, starts, lower, upper, "search")
    best = found.costs.argmin()
    grid = np.stack(np.meshgrid(np.linspace(-5, 5, 1001), np.linspace(-0.5, 5, 551)), axis=-1).reshape(-1, 2)
    assert found.converged[best] and found.points[best, 0] < 0.0
    assert found.costs[best] <= cost(grid).min() + 1e-3
    assert (found.points >= lower).all() and (found.points <= upper).all()
    assert valleys(np.array([[3.0, 1.0, 2.0], [4.0, 5.0, 0.5]]), 2) == [(1, 2), (0, 1)]


def test_each_sensor_gets_its_own_factor_and_missing_ones_do_no_harm():
    rng = np.random.default_rng(3)
    level = np.cumsum(0.3 * rng.standard_normal(700))
    zs = level[:, None] + np.array([1.0, 3.0]) * rng.standard_normal((700, 2))
    zs[rng.random(zs.shape) < 0.1] = np.nan
    kf = of_matrices(RobustKalmanFilter, 1.0, np.ones((2, 1)))
    found = estimate_noise(kf, zs, R="each")
    assert found.R.diagonal() == pytest.approx([1.0, 9.0], rel=0.2)
    assert found.R[0, 1] == 0.0
    same = estimate_noise(kf, zs[:300], R=[0, -1], Q=False)
    assert same.R[1, 1] == 1.0
    assert same.Q == pytest.approx(kf.Q)


@pytest.mark.parametrize("kind", [KalmanFilter, RobustKalmanFilter, noise_given])
def test_the_filter_is_left_alone_until_apply(kind):
    kf = guess(kind)
    before = (kf.x.copy(), kf.P.copy(), kf.R.copy(), kf.Q.copy())
    found = estimate_noise(kf, recording(5, 0.1, 300))
    assert 0.5 < found.R[0, 0] / R < 2.0
    for was, now in zip(before, (kf.x, kf.P, kf.R, kf.Q), strict=True):
        np.testing.assert_array_equal(was, now)
    assert found.apply(kf) is kf
    np.testing.assert_array_equal(kf.R, found.R)
    if kind is noise_given:
        assert (kf.noise.contamination, kf.noise.scale_ratio) == (found.contamination, found.scale_ratio)


NINE = np.r_[np.ones(9), np.full(41, np.nan)]


@pytest.mark.parametrize(("change", "match"), [
    ({"R": "all"}, "R: expected one of"), ({"R": [0, 1]}, "R: expected True"),
    ({"Q": [0, 2]}, "Q: expected groups numbered"), ({"contamination": 1.0}, "contamination"),
    ({"scale_ratio": 0.5}, "scale_ratio"), ({"zs": np.zeros(5)}, "at least 10"),
    ({"zs": NINE}, r"zs: expected at least 10 measurements .*not missing, got 9 in 50"),
    ({"filter": object()}, "linear filter"), ({"filter": ExtendedKalmanFilter(2, 1)}, "linear filter"),
    *(({name: [np.eye(1 if name == "Hs" else 2, 2)] * 49}, f"{name}: expected an entry for each of the 50")
      for name in ("us", "Fs", "Qs", "Hs", "Rs")),
])  # fmt: skip
def test_bad_input_is_refused_by_name(change, match):
    with pytest.raises((ValueError, TypeError), match=match):
        estimate_noise(**{"filter": guess(), "zs": np.zeros(50), **change})


def test_on_clean_data_the_parts_of_the_mixture_keep_their_roles():
    for seed in range(3):
        zs = random_walk(seed, 200)
        found = estimate_noise(level(Q=0.25), zs, Q=False)
        assert found.R[0, 0] == pytest.approx(1.0, abs=0.5) and found.contamination < 0.15
    # Two sentinel values are two outliers; what is missing is None, NaN or a masked entry.
    zs[[50, 120]] = -1e200
    wild = estimate_noise(level(Q=0.25), zs, Q=False)
    assert wild.R[0, 0] == pytest.approx(found.R[0, 0], rel=0.1) and wild.contamination < 0.15
    zs[[5, 60, 61]] = np.nan
    expected, none = estimate_noise(level(), zs[:100]), [None if np.isnan(z) else z for z in zs[:100]]
    for given in (none, [None if z is None else [z] for z in none], np.ma.masked_invalid(zs[:100]), zs[:100, None]):
        assert estimate_noise(level(), given).log_likelihood == expected.log_likelihood
    assert np.isfinite(estimate_noise(level(), np.r_[NINE, -1.0]).R).all()


def test_a_contamination_at_its_limit_is_said():
    rng = np.random.default_rng(1)
    zs = rng.standard_normal(600) * np.where(rng.random(600) < 0.6, 30.0, 1.0)
    found = estimate_noise(level(Q=1e-6), zs, Q=False)
    assert not found.converged
    assert found.contamination == pytest.approx(0.45, abs=1e-3) and "contamination" in found.message


def test_a_search_that_did_not_end_is_said(monkeypatch):
    def unended(fit, ends=NoiseFit.ends):
        found = ends(fit)
        found.converged[:] = np.arange(len(found.converged)) > 0
        return found

    monkeypatch.setattr(NoiseFit, "ends", unended)
    found = estimate_noise(level(0.9, R=1.0, Q=1.0, P=5.0), random_walk(0, 200, 0.9, 1.0))
    assert not found.converged and found.message == "the search did not end"


@pytest.mark.parametrize("start", [0.01, 100.0])
def test_what_is_not_determined_is_said(start):
    """Q far above R: the sum of both is all that one sees."""
    zs = np.cumsum(100.0 * np.random.default_rng(0).standard_normal(300))
    with pytest.warns(UserWarning, match="R's factor 0: not determined"):
        found = estimate_noise(level(Q=1e4, R=start), zs)
    assert not found.converged and "R's factor 0: not determined" in found.message
    assert found.Q[0, 0] == pytest.approx(1e4, rel=0.3)


def test_matrices_of_each_step_and_inputs_are_those_of_batch_filter():
    """The log-likelihood at the estimate is that of a filter with this noise, which batch_filter takes through it."""
    rng, n = np.random.default_rng(3), 120
    steps = {
        "Fs": [np.array([[1.0, dt], [0.0, 0.95]]) for dt in rng.uniform(0.5, 1.5, n)],
        "Hs": [np.array([[h, 0.1]]) for h in rng.uniform(0.5, 2.0, n)], "us": rng.choice([-1.0, 1.0], (n, 1)),
    }  # fmt: skip
    Qs, Rs = [q * Q for q in rng.uniform(0.5, 2.0, n)], [np.array([[r]]) for r in rng.uniform(0.5, 8.0, n)]
    kf, matched = guess(), guess(noise_given)
    kf.B = matched.B = np.array([[0.5], [1.0]])
    zs = np.cumsum(rng.standard_normal(n)) + np.sqrt(np.ravel(Rs)) * rng.standard_normal(n)
    zs[7] = np.nan
    outliers = {"contamination": 0.05, "scale_ratio": 8.0}
    found = estimate_noise(kf, zs, Qs=Qs, Rs=Rs, **steps, **outliers)
    matched.noise, matched.x, total = Contaminated(0.05, 8.0), matched.x[:, 0], []
    saver = SimpleNamespace(save=lambda: total.append(matched.log_likelihood))
    scaled = {"Qs": [found.Q_scale[0] * one for one in Qs], "Rs": [found.R_scale[0] * one for one in Rs]}
    matched.batch_filter(zs, **scaled, saver=saver, **steps)
    assert found.log_likelihood == pytest.approx(sum(total), rel=1e-9)
    np.testing.assert_allclose(found.R, found.R_scale[0] * kf.R)


def test_a_trackers_noise_is_estimated_with_its_regressors():
    rng = np.random.default_rng(4)
    n, u = 800, rng.choice([-1.0, 1.0], 800)
    y = np.zeros(n)
    v = 0.3 * rng.standard_normal(n) * np.where(rng.random(n) < 0.1, 10.0, 1.0)
    for k in range(1, n):
        y[k] = 0.7 * y[k - 1] + u[k - 1] + v[k]
    y[50] = np.nan
    tracker = ParameterTracker(ARX(1, 1), P=1.0, Q=1e-8 * np.eye(2), R=10.0)
    theta = tracker.theta.copy()
    found = estimate_noise(tracker, y, us=u, Q=False)
    assert found.R[0, 0] == pytest.approx(0.09, rel=0.25)
    assert found.contamination == pytest.approx(0.1, abs=0.05)
    np.testing.assert_array_equal(tracker.theta, theta)
    assert tracker.R == 10.0
    assert found.apply(tracker) is tracker and tracker.R == found.R
    with pytest.raises(TypeError, match="Fs, Qs, Hs, Rs: expected only for a filter"):
        estimate_noise(tracker, y, us=u, Hs=[np.eye(1)] * n)


@pytest.mark.nightly
def test_an_interval_ends_where_the_best_of_the_others_costs_what_the_level_allows():
    """The others are fitted anew with the factor given; chi2(.9)/2 with one degree of freedom is 1.353 nats."""
    zs, outliers = random_walk(5, 300), {"contamination": 0.05, "scale_ratio": 10.0}
    found = estimate_noise(level(R=0.1), zs, **outliers)
    intervals, wider = found.intervals(0.9), found.intervals(0.99)
    ends = {"R": (intervals.R_scale[0], lambda end: {"R": 0.1 * end}),
            "Q": (intervals.Q_scale[0], lambda end: {"R": 0.1, "Q": end})}  # fmt: skip
    for name, ((low, high), given) in ends.items():
        assert 0.0 < low < high < np.inf
        for end in (low, high):
            best = estimate_noise(level(**given(end)), zs, **{name: False}, **outliers)
            assert found.log_likelihood - best.log_likelihood == pytest.approx(1.353, abs=0.08)
    assert wider.R_scale[0, 0] < intervals.R_scale[0, 0] and wider.R_scale[0, 1] > intervals.R_scale[0, 1]
    assert np.array_equal(pickle.loads(pickle.dumps(found)).intervals(0.9).Q_scale, intervals.Q_scale)


@pytest.mark.filterwarnings("ignore:estimate_noise")
def test_what_the_recording_does_not_limit_has_no_limit():
    """Q far above R: R is small, nobody knows how small. What was not fitted is what was given."""
    zs = np.cumsum(100.0 * np.random.default_rng(0).standard_normal(100))
    intervals = estimate_noise(level(Q=1e4), zs, contamination=0.0, scale_ratio=10.0).intervals()
    assert intervals.R_scale[0, 0] == 0.0 and np.isfinite(intervals.R_scale[0, 1])
    assert 0.5 < intervals.Q_scale[0, 0] < intervals.Q_scale[0, 1] < 2.0
    fixed = estimate_noise(level(R=1e4), zs, Q=False, contamination=0.0, scale_ratio=10.0).intervals()
    assert fixed.Q_scale.tolist() == [[1.0, 1.0]]
    with pytest.raises(ValueError, match=r"level: expected a number between 0 and 1, got 95"):
        estimate_noise(level(), zs).intervals(95)


def test_noise_that_is_next_to_nothing_is_never_the_most_likely():
    """Three sensors of two states: what contradicts itself is worth less, the smaller the noises are said to be."""
    rng = np.random.default_rng(9)
    kf = of_matrices(RobustKalmanFilter, 0.8, rng.normal(size=(3, 2)), P=10.0)
    zs = rng.normal(size=(60, 3))
    data = of_filter(kf, zs, None, None, None, None, None)
    logs = np.array([0.0, -10.0, -20.0, -30.0])[:, None]
    found = log_likelihoods(data, logs * np.ones(3), logs * np.ones(2), np.full(4, 0.4), np.full(4, 3.0))
    assert (np.diff(found) < -100.0).all()


@pytest.mark.parametrize("wide", by_night([1e12, 1e14, 1e200], 1e14))
def test_an_initial_covariance_far_wider_than_the_recording_costs_no_digits(wide):
    """Next to 1e14 an R of .01 is lost in rounding: the fit was biased, or ended in a LinAlgError."""
    rng, zs = np.random.default_rng(5), np.empty(200)
    x = np.array([100.0, 1.0])
    for k in range(len(zs)):
        x = np.array([[1.0, 1.0], [0.0, 1.0]]) @ x + 0.01 * np.array([0.5, 1.0]) * rng.standard_normal()
        zs[k] = x[0] + 0.1 * rng.standard_normal()
    found = []
    for P in (1e7, wide):
        kf = of_matrices(KalmanFilter, [[1.0, 1.0], [0.0, 1.0]], np.eye(1, 2), np.outer([0.5, 1.0], [0.5, 1.0]), P=P)
        found.append(estimate_noise(kf, zs))
    assert found[1].R[0, 0] == pytest.approx(found[0].R[0, 0], rel=1e-3)
    assert found[1].Q[1, 1] == pytest.approx(found[0].Q[1, 1], rel=1e-3)
    # Two states that nobody knew: each is less likely by the width of what it was drawn from.
    assert found[1].log_likelihood == pytest.approx(found[0].log_likelihood - np.log(wide / 1e7), abs=0.01)
