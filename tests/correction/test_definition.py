"""The correction, sensor by sensor: what its equations promise, held to formulas from elsewhere."""

import numpy as np
import pytest
import support
from numpy.testing import assert_allclose, assert_array_equal

from robust_filterpy import Huber, StudentT, TukeyBiweight
from robust_filterpy.correction import NotPositiveDefiniteError, SingularInnovationError
from robust_filterpy.correction.definition import correct, embed_block, innovation_moments
from robust_filterpy.correction.options import Choices
from robust_filterpy.influence import Hampel, Linear

pytestmark = pytest.mark.core


def problem(n, m, seed):
    """A prior, and an innovation's moments with R that correlates the sensors."""
    rng = np.random.default_rng(seed)
    A, B, H = rng.normal(size=(n, n)), rng.normal(size=(m, m)), rng.normal(size=(m, n))
    x, P, R = rng.normal(size=n), A @ A.T + np.eye(n), B @ B.T + 0.5 * np.eye(m)
    C, S = innovation_moments(P, H, R)
    y = np.linalg.cholesky(S) @ rng.normal(size=m)
    return x, P, y, C, S


def kalman(x, P, y, C, S):
    gain = C @ np.linalg.inv(S)
    return x + gain @ y, P - gain @ C.T


@pytest.mark.parametrize("grouping", ["component", "joint", ((0, 2), (1,)), ((2, 1),)])
@pytest.mark.parametrize("scaling", ["innovation", "learnt"])
def test_an_infinite_threshold_is_the_kalman_filter(scaling, grouping):
    for seed in range(20):
        given = problem(4, 3, seed)
        found = correct(*given, Choices(Linear(), scaling, grouping=grouping))
        x, P = kalman(*given)
        assert_allclose(found.x, x, rtol=1e-11, atol=1e-11)
        assert_allclose(found.P, P, rtol=1e-10, atol=1e-10)
        assert_array_equal(found.P, found.P.T)
        assert_array_equal(found.weights, 1.0)


def test_log_density_of_linear_is_the_normal_one():
    from scipy import stats

    x, P, y, C, S = problem(3, 4, 7)
    found = correct(x, P, y, C, S, Choices(Linear()))
    assert found.log_density == pytest.approx(stats.multivariate_normal(cov=S).logpdf(y), rel=1e-10)


@pytest.mark.parametrize("size", [1.0, 30.0, 1e6])
def test_T_is_the_inverse_cholesky_factor_of_S_in_the_order_taken(size):
    x, P, y, C, S = problem(4, 4, 3)
    found = correct(x, P, size * y, C, S)
    order = [i for group in found.order for i in group]
    assert sorted(order) == [0, 1, 2, 3]
    root = np.linalg.inv(np.linalg.cholesky(S[np.ix_(order, order)]))
    expected = np.zeros((4, 4))
    expected[np.ix_(order, order)] = root
    assert_allclose(found.T, expected, rtol=1e-9, atol=1e-12)
    assert_allclose(found.T @ S @ found.T.T, np.eye(4), atol=1e-11)


@pytest.mark.parametrize("scaling", ["innovation", "bounded"])
@pytest.mark.parametrize("influence", [Huber(), Huber(0.3), Hampel(), TukeyBiweight(), StudentT()], ids=repr)
def test_the_gain_times_the_bounded_innovation_moves_the_state(influence, scaling):
    for seed in range(10):
        x, P, y, C, S = problem(3, 3, seed)
        found = correct(x, P, 5.0 * y, C, S, Choices(influence, scaling))
        assert_allclose(x + found.K @ found.y_bounded, found.x, rtol=1e-9, atol=1e-9)
        assert_allclose(x + C @ found.score, found.x, rtol=1e-9, atol=1e-9)
        assert_allclose(P - C @ found.information @ C.T, found.P, rtol=1e-9, atol=1e-9)


def test_the_most_plausible_sensor_is_taken_first():
    x, P, H, R = np.zeros(2), np.eye(2), np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), np.eye(3)
    C, S = innovation_moments(P, H, R)
    found = correct(x, P, np.array([50.0, 0.1, 1.0]), C, S)
    assert found.order == ((1,), (2,), (0,))
    # The wild one is judged against what the other has told: variance 1/2 + 1 around .05.
    assert found.e[0] == pytest.approx((50.0 - 0.05) / np.sqrt(1.5))


def test_by_hand_two_redundant_sensors_one_wild():
    """First y_1 by a plain step, then y_0, clipped at k standard deviations of what is left."""
    x, P, H, R, k = np.zeros(1), np.array([[4.0]]), np.ones((2, 1)), np.eye(2), 1.345
    C, S = innovation_moments(P, H, R)
    found = correct(x, P, np.array([1000.0, 1.0]), C, S, Choices(Huber(k)))
    mean, var = 4.0 / 5.0 * 1.0, 4.0 / 5.0
    assert found.x[0] == pytest.approx(mean + var / np.sqrt(var + 1.0) * k)
    assert found.P[0, 0] == pytest.approx(var)
    assert_array_equal(found.clipped, [True, False])


@pytest.mark.parametrize("wild", [1e3, 1e36, 1e150, 1e300])
def test_a_wild_value_does_not_touch_sensors_that_are_uncorrelated_with_it(wild):
    rng = np.random.default_rng(0)
    P = np.diag([1.0, 2.0, 3.0])
    C, S = innovation_moments(P, np.eye(3), np.eye(3))
    y = np.array([wild, *rng.normal(scale=0.1, size=2)])
    found, without = correct(np.zeros(3), P, y, C, S), correct(np.zeros(3), P, np.array([np.nan, *y[1:]]), C, S)
    assert_array_equal(found.weights[1:], 1.0)
    assert_array_equal(found.x[1:], without.x[1:])


@pytest.mark.parametrize("grouping", ["component", "joint", ((0, 1), (2, 3))])
def test_permuting_sensors_changes_nothing(grouping):
    rng = np.random.default_rng(1)
    for seed in range(20):
        x, P, y, C, S = problem(3, 4, seed)
        y = y * rng.choice([1.0, 1.0, 30.0], 4)
        order = rng.permutation(4)
        inverse = np.argsort(order)
        named = grouping if isinstance(grouping, str) else tuple(tuple(int(inverse[i]) for i in g) for g in grouping)
        one = correct(x, P, y, C, S, Choices(grouping=grouping))
        other = correct(x, P, y[order], C[:, order], S[np.ix_(order, order)], Choices(grouping=named))
        assert_allclose(other.x, one.x, rtol=1e-9, atol=1e-9)
        assert_allclose(other.P, one.P, rtol=1e-9, atol=1e-9)
        assert_allclose(other.weights, one.weights[order], rtol=1e-9)


@pytest.mark.parametrize("grouping", ["component", "joint"])
def test_the_units_of_the_sensors_do_not_matter(grouping):
    for seed in range(10):
        x, P, y, C, S = problem(3, 3, seed)
        unit = np.array([1e-8, 1.0, 1e8])
        one = correct(x, P, 9.0 * y, C, S, Choices(grouping=grouping))
        other = correct(x, P, 9.0 * y * unit, C * unit, S * np.outer(unit, unit), Choices(grouping=grouping))
        assert_allclose(other.x, one.x, rtol=1e-9, atol=1e-10)
        assert_allclose(other.P, one.P, rtol=1e-9, atol=1e-10)


def test_a_group_is_bounded_by_its_length():
    """psi of the length along it, and the Jacobian (k/|e|)(I - e e'/|e|^2) as information."""
    k, S = 2.0, 5.0 * np.eye(2)
    C = P = 4.0 * np.eye(2)
    y = np.array([30.0, 40.0])
    found = correct(np.zeros(2), P, y, C, S, Choices(Huber(k), grouping="joint"))
    e, r = y / np.sqrt(5.0), 50.0 / np.sqrt(5.0)
    assert_allclose(found.x, 4.0 / np.sqrt(5.0) * k * e / r)
    D = k / r * (np.eye(2) - np.outer(e, e) / r**2)
    assert_allclose(found.P, P - 16.0 / 5.0 * D)
    assert_allclose(found.weights, k / r)


def test_the_threshold_is_in_units_of_the_spread():
    one = np.eye(1)
    plain = correct(np.zeros(1), one, np.array([6.0]), one, 2.0 * one)
    wide = correct(np.zeros(1), one, np.array([6.0]), one, 2.0 * one, Choices(scaling="learnt"), widths=np.array([5.0]))
    assert plain.clipped[0] and not wide.clipped[0]
    wild = correct(np.zeros(1), one, np.array([1e9]), one, 2.0 * one, Choices(scaling="learnt"), widths=np.array([5.0]))
    assert wild.x[0] == pytest.approx(5.0 * plain.x[0])


def test_unit_and_bounded_are_the_papers_modification():
    """x + C psi(y), P - C psi' C' (42)-(44); bounded is the same while S < 1."""
    P, C, S = np.array([[0.3]]), np.array([[0.3]]), np.array([[0.8]])
    for scaling in ("unit", "bounded"):
        found = correct(np.array([1.0]), P, np.array([0.5]), C, S, Choices(Huber(1.0), scaling))
        assert_allclose(found.x, 1.0 + 0.3 * 0.5)
        assert_allclose(found.P, 0.3 - 0.3 * 0.3)
        assert_allclose(found.K, C)
    wide = correct(np.array([1.0]), 9.0 * P, np.array([0.5]), 9.0 * C, 4.0 * S, Choices(Huber(1.0), "bounded"))
    assert_allclose(wide.x, 1.0 + 2.7 * 0.5 / 3.2)
    with pytest.raises(NotPositiveDefiniteError, match="unit"):
        correct(np.array([1.0]), 9.0 * P, np.array([0.5]), 9.0 * C, 4.0 * S, Choices(Huber(1.0), "unit"))


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


def test_missing_components_are_as_if_they_were_not_there():
    x, P, y, C, S = problem(3, 4, 11)
    gaps = y.copy()
    gaps[[1, 3]] = np.nan
    found, part = correct(x, P, 20 * gaps, C, S), np.array([0, 2])
    fewer = correct(x, P, 20 * y[part], C[:, part], S[np.ix_(part, part)])
    assert_array_equal(found.x, fewer.x)
    assert_array_equal(found.P, fewer.P)
    assert_array_equal(np.isnan(found.weights), [False, True, False, True])
    assert found.log_density == fewer.log_density
    support.assert_close(found.inverse[np.ix_(part, part)], np.linalg.inv(S[np.ix_(part, part)]), 1e-10, "SI")


@pytest.mark.parametrize("grouping", [((0, 0),), ((0,), (0, 1)), ((-1,),), ((),), ((0, 1.5),)])
def test_groups_that_make_no_sense_are_refused(grouping):
    with pytest.raises((ValueError, TypeError), match="grouping"):
        Choices(grouping=grouping)


def test_a_block_beside_others_is_uncorrelated_with_them():
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
