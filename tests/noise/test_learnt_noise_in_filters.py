"""What any part of the package learns of noise is what any filter takes."""

import numpy as np
import pytest
import support
from filterpy.kalman import KalmanFilter

from robust_filterpy import (
    ARX,
    Contaminated,
    ParameterTracker,
    RobustKalmanFilter,
    RobustUnscentedKalmanFilter,
    estimate_noise,
    identify,
    robust,
    smooth,
)
from robust_filterpy.filters import RobustCubatureKalmanFilter

TRUTH = Contaminated(0.15, 10.0, scale=0.5)


def walk(**options):
    return support.of_matrices(RobustKalmanFilter, 1.0, [[1.0]], 0.01, 0.25, **options)


@pytest.fixture(scope="module")
def recording():
    rng = np.random.default_rng(71)
    x = np.cumsum(0.1 * rng.normal(size=600))
    return x, x + TRUTH.rvs(size=600, random_state=rng)


def identified(zs):
    rng = np.random.default_rng(72)
    u, y = rng.choice([-1.0, 1.0], 600), np.zeros(600)
    noise = TRUTH.rvs(size=600, random_state=rng)
    for k in range(1, 600):
        y[k] = 0.7 * y[k - 1] + u[k - 1] + noise[k]
    return identify(y, u, ARX(1, 1)).noise.influence


LEARNT = {
    "identify": identified,
    "smooth": lambda zs: smooth(walk(), zs).noise,
    "estimate_noise": lambda zs: estimate_noise(walk(), zs).noise,
    "fit": lambda zs: Contaminated.fit(np.diff(zs[::2])),
}


@pytest.fixture(scope="module", params=LEARNT.values(), ids=LEARNT)
def learnt(request, recording):
    found = request.param(recording[1])
    assert type(found) is Contaminated
    return Contaminated(found.contamination, found.scale_ratio)


def test_it_is_the_noise_that_there_was(learnt):
    # What overlaps with ordinary noise looks like it; differences have two chances of an outlier each.
    assert 0.08 < learnt.contamination < 0.35 and 5.0 < learnt.scale_ratio < 16.0


def test_a_filter_with_it_follows_better_than_the_default_and_as_the_truth(learnt, recording):
    x, zs = recording
    given, truth = ({"noise": noise} for noise in (learnt, Contaminated(0.15, 10.0)))
    default, given, truth = (
        float(np.mean((walk(**options).batch_filter(zs)[0][:, 0] - x) ** 2)) for options in ({}, given, truth)
    )
    assert given < default and given < 1.1 * truth


def test_every_filter_takes_it(learnt):
    plain = support.of_matrices(KalmanFilter, [[1.0]], [[1.0]])
    kinds = (RobustKalmanFilter, support.Extended, RobustUnscentedKalmanFilter, RobustCubatureKalmanFilter)
    filters = [support.of_matrices(kind, [[1.0]], [[1.0]], noise=learnt) for kind in kinds]
    for kf in (*filters, robust(plain, noise=learnt)):
        support.predict_and_update(kf, np.array([100.0]))
        assert kf.noise == learnt and kf.outlier_probability > 0.99
    tracker = ParameterTracker(ARX(1, 1), filter=RobustKalmanFilter(2, 1, noise=learnt))
    tracker.update(1.0, 1.0)
    # It is an influence function of a filter as well.
    kf = walk(influence=learnt, scaling="innovation")
    support.predict_and_update(kf, 100.0)
    assert kf.weights[0, 0] < 0.1


def test_a_size_of_its_own_is_refused_since_the_matrix_says_it():
    with pytest.raises(ValueError, match=r"noise: expected scale=1, got .*scale=0.5\); set R to"):
        walk(noise=TRUTH)
    with pytest.raises(ValueError, match=r"process: expected scale=1, .* set Q to scale\*\*2"):
        walk(noise="learnt", process=TRUTH)


@pytest.mark.parametrize("contamination, ratio", [(0.05, 20.0), (0.1, 10.0), (0.3, 6.0)])
def test_fit_finds_what_was_drawn(contamination, ratio):
    truth = Contaminated(contamination, ratio, scale=2.0)
    data = truth.rvs(size=20_000, random_state=73)
    data[::7] = np.nan
    found = Contaminated.fit(data)
    assert found.contamination == pytest.approx(contamination, abs=0.02)
    assert found.scale_ratio == pytest.approx(ratio, rel=0.1) and found.scale == pytest.approx(2.0, rel=0.03)
    assert Contaminated.fit(data, scale=2.0).scale == 2.0


@pytest.mark.parametrize("data", [[], [1.0], [np.nan, 1.0], [1.0, np.inf]])
def test_fit_refuses_what_tells_nothing(data):
    with pytest.raises(ValueError, match="data: expected two finite numbers"):
        Contaminated.fit(data)
    assert np.isfinite(Contaminated.fit(np.zeros(10)).scale)
