"""The correction, sensor by sensor: what its equations promise, held to formulas from elsewhere."""

import numpy as np
import pytest
import support
from numpy.testing import assert_allclose, assert_array_equal

from robust_filterpy import Huber, StudentT, TukeyBiweight
from robust_filterpy.correction import SingularInnovationError
from robust_filterpy.correction.definition import correct, embed_block, innovation_moments
from robust_filterpy.correction.options import Choices, typical_length
from robust_filterpy.influence import Hampel

pytestmark = pytest.mark.core


def problem(n, m, seed):
    """A prior, and an innovation's moments with R that correlates the sensors."""
    rng = np.random.default_rng(seed)
    A, B, H = rng.normal(size=(n, n)), rng.normal(size=(m, m)), rng.normal(size=(m, n))
    x, P, R = rng.normal(size=n), A @ A.T + np.eye(n), B @ B.T + 0.5 * np.eye(m)
    C, S = innovation_moments(P, H, R)
    y = np.linalg.cholesky(S) @ rng.normal(size=m)
    return x, P, y, C, S


@pytest.mark.parametrize("scaling", ["innovation", "bounded"])
@pytest.mark.parametrize("influence", [Huber(), Huber(0.3), Hampel(), TukeyBiweight(), StudentT()], ids=repr)
def test_score_and_information_are_what_moves_x_and_P(influence, scaling):
    for seed in range(10):
        x, P, y, C, S = problem(3, 3, seed)
        found = correct(x, P, 5.0 * y, C, S, Choices(influence, scaling))
        assert_allclose(x + C @ found.score, found.x, rtol=1e-9, atol=1e-9)
        assert_allclose(P - C @ found.information @ C.T, found.P, rtol=1e-9, atol=1e-9)


def test_the_most_plausible_sensor_is_taken_first():
    """The wild one is then clipped at k standard deviations of what the others have left."""
    x, P, H, R, k = np.zeros(2), np.diag([4.0, 1.0]), np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), np.eye(3), 1.345
    C, S = innovation_moments(P, H, R)
    found = correct(x, P, np.array([1000.0, 0.1, 1.0]), C, S, Choices(Huber(k)))
    mean, var = 4.0 / 5.0 * 0.1, 4.0 / 5.0
    assert found.order == ((1,), (2,), (0,))
    assert found.e[0] == pytest.approx((1000.0 - mean) / np.sqrt(var + 1.0))
    assert found.x[0] == pytest.approx(mean + var / np.sqrt(var + 1.0) * k) and found.P[0, 0] == pytest.approx(var)
    assert_array_equal(found.clipped, [True, False, False])


def test_the_threshold_is_in_units_of_the_spread():
    one = np.eye(1)
    plain = correct(np.zeros(1), one, np.array([6.0]), one, 2.0 * one)
    wide = correct(np.zeros(1), one, np.array([6.0]), one, 2.0 * one, Choices(scaling="learnt"), widths=np.array([5.0]))
    assert plain.clipped[0] and not wide.clipped[0]
    wild = correct(np.zeros(1), one, np.array([1e9]), one, 2.0 * one, Choices(scaling="learnt"), widths=np.array([5.0]))
    assert wild.x[0] == pytest.approx(5.0 * plain.x[0])


def test_a_sensor_that_the_others_determine_is_refused_or_left_out():
    P, H = np.eye(2), np.array([[1.0, 0.0], [2.0, 0.0]])
    C, S = innovation_moments(P, H, np.zeros((2, 2)))
    given = np.zeros(2), P, np.array([1.0, 2.0]), C, S
    with pytest.raises(SingularInnovationError, match="singular"):
        correct(*given)
    found = correct(*given, skip_singular=True)
    assert_allclose(found.x, [1.0, 0.0])
    assert_allclose(found.P, np.diag([0.0, 1.0]), atol=1e-12)


def test_redundant_sensors_with_a_minority_bad_stay_bounded():
    """The good ones alone give |x| <= r and P <= p; each bad one moves x by at most k sqrt(p) after them.

    A bad sensor is judged last, given the good ones, and moves x by at most C t k with C t <= sqrt(P); with q bad
    ones |x| <= r + q k sqrt(p), however large they are. P is never larger than before.
    """
    k, n_good, rng = 1.345, 3, np.random.default_rng(5)
    for bad in (1, 2):
        for wild in (1e2, 1e6, 1e200):
            m = n_good + bad
            x, P = np.zeros(1), np.array([[100.0]])
            for _ in range(50):
                P = P + 0.01
                C, S = innovation_moments(P, np.ones((m, 1)), np.eye(m))
                z = np.r_[0.1 * rng.normal(size=n_good), np.full(bad, wild) + rng.normal(size=bad)]
                found = correct(x, P, z - x[0], C, S, Choices(Huber(k)))
                assert found.P[0, 0] <= P[0, 0] + 1e-12
                x, P = found.x, found.P
            assert abs(x[0]) <= 0.5 + bad * k * np.sqrt(1.0 / n_good)
            assert P[0, 0] <= 1.0 / n_good + 0.01


def test_a_block_of_its_own_is_uncorrelated_with_them():
    """What a joint correction before had between this block and the others is gone from S and from the information."""
    rng = np.random.default_rng(0)
    x, P, H, R = np.zeros(3), support.spd(rng, 3), rng.normal(size=(3, 3)), np.eye(3)
    C, S = innovation_moments(P, H, R)
    whole = correct(x, P, np.array([0.3, -0.2, 4.0]), C, S, Choices(grouping="joint"))
    assert (np.abs(whole.S[1, [0, 2]]) > 1e-3).all() and (np.abs(whole.information[1, [0, 2]]) > 0.0).any()
    C1, S1 = innovation_moments(P, H[1:2], R[1:2, 1:2])
    some = correct(x, P, np.array([0.1]), C1, S1, Choices())
    for before in (whole, None):
        found = embed_block(before, some, 1, 3)
        for both, block in ((found.S, some.S), (found.information, some.information)):
            assert both[1, 1] == block[0, 0]
            assert_array_equal(both[1, [0, 2]], 0.0)
            assert_array_equal(both[[0, 2], 1], 0.0)
        if before is not None:
            assert_array_equal(found.S[np.ix_([0, 2], [0, 2])], whole.S[np.ix_([0, 2], [0, 2])])


@pytest.mark.parametrize("k", [1, 2, 5])
def test_the_typical_length_of_a_group_is_in_units_of_one_sensors(k):
    lengths = np.linalg.norm(np.random.default_rng(k).normal(size=(200_000, k)), axis=1)
    # Five standard errors of the median.
    assert np.median(lengths) * typical_length(k) == pytest.approx(0.674490, abs=5 * 1.2533 / 200_000**0.5)
