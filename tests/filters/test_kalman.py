"""One update of the robust filter is the correction of the paper, and it shows what it did."""

import numpy as np
import pytest
import scipy.stats
import support
from filterpy.kalman import KalmanFilter
from statsmodels.robust import norms

from robust_filterpy import Huber, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.influence import Hampel, Linear
from robust_filterpy.influence.information import expected_information

pytestmark = pytest.mark.core

K = 1.345
FORMULAS = support.HuberFormulas(K)
SCALINGS = ["innovation", "bounded", "unit"]
COMPONENT = [("component", information) for information in ("realized", "expected", "weight")]
JOINT = [("joint", information) for information in ("realized", "weight")]
NDIMS = [1, 2]


def robust(problem=None, ndim=2, **choices):
    """A robust filter for the problem, or for one of four states and two sensors."""
    return support.make(RobustKalmanFilter, problem or support.random_problem(21, 4, 2), ndim, **choices)


@pytest.mark.pairwise
@pytest.mark.parametrize("scaling", SCALINGS)
@pytest.mark.parametrize("grouping, information", COMPONENT + JOINT)
@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("z", [[0.1, -0.2, 0.3], [0.1, 40.0, 0.2], [-30.0, 1e4, 7.0]])
@pytest.mark.parametrize("dim_z", [1, 2, 3])
def test_update_is_the_correction(scaling, grouping, information, ndim, z, dim_z):
    z, problem = z[:dim_z], support.mild(4, dim_z)
    choices = {"scaling": scaling, "grouping": grouping, "information": information}
    kf = robust(problem, ndim, **choices)
    reference = support.reference_correction(problem.x, problem.P, z, problem.H, problem.R, FORMULAS, **choices)
    kf.update(z)
    support.assert_corrected(kf, reference, rtol=1e-7 if grouping == "joint" else 1e-9)


@pytest.mark.parametrize("norm", [norms.TukeyBiweight(), norms.Hampel(), norms.HuberT(2.0), norms.AndrewWave()])
@pytest.mark.parametrize("z", [[0.1, -0.2], [2.0, -5.0], [1e3, -9.0], [0.3], [-4.0], [60.0]])
def test_update_with_a_norm_of_statsmodels(norm, z):
    problem = support.random_problem(22, 4, len(z))
    kf = robust(problem, influence=norm)
    reference = support.reference_correction(problem.x, problem.P, z, problem.H, problem.R, norm)
    kf.update(z)
    support.assert_corrected(kf, reference)
    assert np.isfinite(kf.log_likelihood)


@pytest.mark.pairwise
@pytest.mark.parametrize("influence", [Linear(), Huber(0.7), Hampel(), TukeyBiweight(), StudentT(2.5)], ids=repr)
@pytest.mark.parametrize("scaling", SCALINGS)
@pytest.mark.parametrize("information", ["realized", "weight"])
@pytest.mark.parametrize("dim_z", [1, 3])
def test_update_with_every_influence_at_every_size_of_residual(influence, scaling, information, dim_z):
    problem, choices = support.mild(3, dim_z, seed=24), {"scaling": scaling, "information": information}
    for size in (0.0, 0.5, 1.5, 3.0, 5.0, 9.0, 1e3):
        z = (problem.H @ problem.x)[:, 0] + size * np.array([1.0, -0.7, 0.41])[:dim_z]
        kf = robust(problem, influence=influence, **choices)
        reference = support.reference_correction(problem.x, problem.P, z, problem.H, problem.R, influence, **choices)
        kf.update(z)
        support.assert_corrected(kf, reference)


@pytest.mark.parametrize("influence", [Huber(), Hampel(), TukeyBiweight(), StudentT()], ids=repr)
def test_expected_information_reduces_p_by_the_same_amount_whatever_z(influence):
    problem = support.random_problem(22, 4, 1)
    C = problem.P @ problem.H.T
    S = problem.H @ C + problem.R
    for z in (0.0, 2.0, 1e5):
        kf = robust(problem, influence=influence, information="expected")
        kf.update(z)
        support.assert_close(kf.P, problem.P - C @ C.T / S.item() * expected_information(influence), 1e-9)


def test_joint_expected_information_is_the_mean_over_the_chi_distribution():
    problem, m = support.random_problem(23, 5, 3), 3
    chi = scipy.stats.chi(m)
    inside = chi.cdf(K)
    tangential = inside + chi.expect(lambda r: K / r, lb=K, ub=np.inf)
    d = (inside + (m - 1) * tangential) / m
    C = problem.P @ problem.H.T
    S = problem.H @ C + problem.R
    kf = robust(problem, grouping="joint", information="expected")
    kf.update([1.0, 50.0, -2.0])
    support.assert_close(kf.P, problem.P - d * C @ np.linalg.inv(S) @ C.T, 1e-6)


@pytest.mark.parametrize("ndim", NDIMS)
def test_equals_kalman_until_something_is_clipped(ndim):
    problem = support.random_problem(24, 4, 2)
    ours, theirs = robust(problem, ndim, influence=Huber(2.5)), support.make(KalmanFilter, problem, ndim)
    for z in support.simulate(problem, 300, seed=3)[0]:
        for kf in (ours, theirs):
            kf.predict()
            kf.update(z)
        if ours.clipped.any():
            break
        support.assert_same_state(ours, theirs, rtol=1e-9)
    assert ours.clipped.any(), "nothing was clipped, so nothing was shown"
    assert np.abs(ours.x - theirs.x).max() > 1e-6


@pytest.mark.parametrize("scaling", SCALINGS)
@pytest.mark.parametrize("grouping", ["component", "joint"])
@pytest.mark.parametrize("ndim", NDIMS)
def test_what_the_filter_shows(scaling, grouping, ndim):
    problem = support.mild(4, 3)
    kf = robust(problem, ndim, scaling=scaling, grouping=grouping)
    shape = (3, 1) if ndim == 2 else (3,)
    kf.predict()
    kf.update([0.1, 300.0, -0.2])
    for name in ("y", "e", "weights", "clipped", "y_bounded"):
        assert getattr(kf, name).shape == shape, name
    assert kf.clipped.dtype == bool
    assert kf.T.shape == (3, 3)
    e = np.ravel(kf.e)
    support.assert_close(e, kf.T @ np.ravel(kf.y), what="e")
    length = np.full(3, np.linalg.norm(e)) if grouping == "joint" else np.abs(e)
    support.assert_close(np.ravel(kf.weights), np.minimum(1, K / length), what="weights")
    np.testing.assert_array_equal(np.ravel(kf.clipped), length > K)
    assert kf.clipped.any()
    support.assert_close(np.ravel(kf.T @ kf.y_bounded), np.ravel(kf.weights) * e, what="T y_bounded")
    support.assert_close(kf.x_post, kf.x_prior + kf.K @ kf.y_bounded, what="x_post")
    support.assert_close(kf.y, np.reshape([0.1, 300.0, -0.2], shape) - kf.H @ kf.x_prior, what="y is raw")
    assert kf.mahalanobis == pytest.approx(np.sqrt(np.ravel(kf.y) @ kf.SI @ np.ravel(kf.y)), rel=1e-9)


@pytest.mark.parametrize("scaling", ["innovation", "bounded"])
def test_k_is_the_gain_before_psi(scaling):
    problem = support.random_problem(24, 4, 2)
    problem = support.with_(problem, R=problem.R + np.eye(2))
    ours, theirs = robust(problem, scaling=scaling), support.make(KalmanFilter, problem)
    for kf in (ours, theirs):
        kf.update([50.0, -70.0])
    support.assert_close(ours.K, theirs.K)
    support.assert_close(ours.S, theirs.S)
    support.assert_close(ours.SI, theirs.SI)


def test_k_is_the_papers_gain_coefficient_under_unit_scaling():
    kf = robust(support.mild(4, 1), scaling="unit")
    C = kf.P @ kf.H.T
    kf.update(30.0)
    support.assert_close(kf.K, C)
    np.testing.assert_array_equal(kf.T, np.eye(1))


def test_a_sensor_with_a_zero_row_in_h_is_not_one_of_the_group():
    """A tracker's unseen point: what it reports must not decide whether the others are clipped."""
    seen = support.random_problem(25, 4, 2)
    H, R = np.vstack([seen.H, np.zeros(4)]), np.eye(3)
    R[:2, :2] = seen.R
    both = support.with_(seen, H=H, R=R, M=np.zeros((4, 3)))
    for garbage in (0.0, 1e6):
        with_garbage, without = robust(both, grouping="joint"), robust(seen, grouping="joint")
        with_garbage.update([1.0, -2.0, garbage])
        without.update([1.0, -2.0])
        support.assert_same_state(with_garbage, without, ("x", "P"))


def test_before_the_first_update():
    kf = RobustKalmanFilter(3, 2)
    assert np.all(np.isnan(kf.weights)) and not kf.clipped.any()
    assert not kf.e.any() and not kf.y_bounded.any()
    assert kf.weights.shape == kf.clipped.shape == kf.e.shape == kf.y_bounded.shape == (2, 1)
    assert kf.T.shape == (2, 2)


def test_bounded_scaling_is_unit_where_s_is_below_one_and_innovation_above():
    below, above = support.mild(), support.random_problem(25, 4, 2)
    below = support.with_(below, R=0.1 * np.eye(2))
    # Sensors without correlation, for which S^(-1/2) is the innovation's scaling.
    H, R = np.eye(2, 4), 2.0 * np.eye(2)
    above = support.with_(above, H=H, R=R, P=np.diag(np.diag(above.P)))
    for problem, other in ((below, "unit"), (above, "innovation")):
        one, two = robust(problem, scaling="bounded"), robust(problem, scaling=other)
        for kf in (one, two):
            kf.update([0.3, 100.0])
        support.assert_same_state(one, two, (*support.STATE, "y", "K", "S", "T", "e", "weights"))


@pytest.mark.parametrize("place, growth", [(1e3, None), (1e5, 1e6), (1e9, 1e6)])
def test_at_a_jump_that_is_believed_S_grows_by_a_million_at_most(path, place, growth):
    kf, grown = RobustKalmanFilter(1, 1), []
    kf.H[:], kf.Q[:] = 1.0, 0.01
    # None repeats the one before to the last bit.
    for z in [*np.random.default_rng(0).normal(size=60), *(place * (1.0 + 1e-9 * np.arange(6)))]:
        kf.predict()
        before = kf.P[0, 0] + kf.R[0, 0]
        kf.update(z)
        grown.append(kf.S[0, 0] / before - 1.0)
    # The fourth reading that says the same is believed.
    assert np.flatnonzero(np.array(grown) > 1e-6).tolist() == [63]
    assert grown[63] == pytest.approx(growth, rel=1e-9) if growth else 1e5 < grown[63] < 1e6


@pytest.mark.parametrize("first", [0.0, 1.5e-14, -1e-13, 1e-11])
def test_a_first_innovation_of_rounding_is_no_custom(first):
    """The state was set from the first reading, by way of a computation, and that reading is then taken once more."""
    zs = 100.0 + 0.3 * np.arange(60) + np.random.default_rng(0).normal(size=60)
    found = []
    for off in (0.0, first):
        kf = RobustKalmanFilter(2, 1)
        kf.F, kf.H, kf.Q = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), 0.01 * np.eye(2)
        kf.P, kf.x = 10.0 * np.eye(2), np.array([[zs[0]], [0.0]])
        kf.update(zs[0] + off)
        found.append(kf.batch_filter(zs[1:])[0])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9)
