"""The robust filter: its correction, what it shows, and every path that corrects."""

import numpy as np
import pytest
import scipy.stats
import support
from filterpy.kalman import KalmanFilter
from statsmodels.robust import norms

from robust_filterpy import Hampel, Huber, Linear, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.correction import NotPositiveDefiniteError
from robust_filterpy.influence import expected_information

pytestmark = pytest.mark.core

K = 1.345
FORMULAS = support.HuberFormulas(K)
SCALINGS = ["innovation", "bounded", "unit"]
COMPONENT = [("component", information) for information in ("realized", "expected", "weight")]
JOINT = [("joint", information) for information in ("realized", "weight")]
NDIMS = [1, 2]


def mild(dim_x=4, dim_z=2, seed=21):
    """A problem with H P H' < 1, where even unit scaling is a filter."""
    problem = support.random_problem(seed, dim_x, dim_z)
    return support.with_(problem, P=0.02 * problem.P, Q=0.02 * problem.Q, M=0.1 * problem.M, H=0.5 * problem.H)


def robust(problem=None, ndim=2, **choices):
    return support.make(RobustKalmanFilter, problem or support.random_problem(21, 4, 2), ndim, **choices)


def check(kf, reference, rtol=1e-9):
    """Compare everything that the filter shows with the reference."""
    for name in ("x", "y", "e", "weights"):
        support.assert_close(np.ravel(getattr(kf, name)), getattr(reference, name), rtol, name)
    for name in ("P", "S", "T", "K"):
        support.assert_close(getattr(kf, name), getattr(reference, name), rtol, name)
    bounded = np.linalg.solve(reference.T, reference.weights * reference.e)
    support.assert_close(np.ravel(kf.y_bounded), bounded, rtol, "y_bounded")
    support.assert_close(kf.SI, np.linalg.inv(reference.S), rtol, "SI")


@pytest.mark.parametrize("scaling", SCALINGS)
@pytest.mark.parametrize("grouping, information", COMPONENT + JOINT)
@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("z", [[0.1, -0.2], [0.1, 40.0], [-30.0, 1e4]])
def test_update_is_the_correction(scaling, grouping, information, ndim, z):
    problem, choices = mild(), {"scaling": scaling, "grouping": grouping, "information": information}
    kf = robust(problem, ndim, **choices)
    reference = support.reference_correction(problem.x, problem.P, z, problem.H, problem.R, FORMULAS, **choices)
    kf.update(z)
    check(kf, reference, rtol=1e-7 if grouping == "joint" else 1e-9)


@pytest.mark.parametrize("norm", [norms.TukeyBiweight(), norms.Hampel(), norms.HuberT(2.0), norms.AndrewWave()])
@pytest.mark.parametrize("z", [[0.1, -0.2], [2.0, -5.0], [1e3, -9.0]])
def test_update_with_a_norm_of_statsmodels(norm, z):
    problem = support.random_problem(22, 4, 2)
    kf = robust(problem, influence=norm)
    reference = support.reference_correction(problem.x, problem.P, z, problem.H, problem.R, norm)
    kf.update(z)
    check(kf, reference)
    assert np.isfinite(kf.log_likelihood)


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
    problem = mild(4, 3)
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
    kf = robust(mild(), scaling="unit")
    C = kf.P @ kf.H.T
    kf.update([0.1, 30.0])
    support.assert_close(kf.K, C)
    np.testing.assert_array_equal(kf.T, np.eye(2))


def test_before_the_first_update():
    kf = RobustKalmanFilter(3, 2)
    assert np.all(np.isnan(kf.weights)) and not kf.clipped.any()
    assert not kf.e.any() and not kf.y_bounded.any()
    assert kf.weights.shape == kf.clipped.shape == kf.e.shape == kf.y_bounded.shape == (2, 1)
    assert kf.T.shape == (2, 2)


def test_bounded_scaling_is_unit_where_s_is_below_one_and_innovation_above():
    below, above = mild(), support.random_problem(25, 4, 2)
    below = support.with_(below, R=0.1 * np.eye(2))
    above = support.with_(above, R=above.R + np.eye(2))
    for problem, other in ((below, "unit"), (above, "innovation")):
        one, two = robust(problem, scaling="bounded"), robust(problem, scaling=other)
        for kf in (one, two):
            kf.update([0.3, 100.0])
        support.assert_same_state(one, two, (*support.STATE, "y", "K", "S", "T", "e", "weights"))


PATHS = {
    "update": lambda kf, z: kf.update(z),
    "update with R and H": lambda kf, z: kf.update(np.reshape(z, kf.y.shape), R=kf.R + np.eye(2), H=kf.H + 0.1),
    "update_correlated": lambda kf, z: kf.update_correlated(z),
    "update_sequential": lambda kf, z: kf.update_sequential(0, np.array(z)),
    "update_steadystate": lambda kf, z: kf.update_steadystate(z),
    "batch_filter": lambda kf, z: kf.batch_filter([np.reshape(z, kf.y.shape)]),
    "batch_filter update_first": lambda kf, z: kf.batch_filter([np.reshape(z, kf.y.shape)], update_first=True),
}


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("influence", [Huber(), Hampel(), TukeyBiweight(), StudentT()], ids=repr)
def test_every_path_bounds_the_correction(path, ndim, influence):
    """Once clipped, a larger outlier moves the state no further."""
    problem = support.random_problem(26, 4, 2)
    states = []
    for size in (1e6, 1e12, 1e300):
        kf = robust(problem, ndim, influence=influence)
        kf.update([0.1, 0.2])
        PATHS[path](kf, [size, -size])
        states.append((np.ravel(kf.x), kf.P))
        support.assert_positive_definite(kf.P)
    for x, P in states[1:]:
        np.testing.assert_allclose(x, states[0][0], rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(P, states[0][1], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("ndim", NDIMS)
def test_get_update_is_update_and_changes_nothing(ndim):
    problem = support.random_problem(26, 4, 2)
    kf = robust(problem, ndim)
    kf.update([0.1, 0.2])
    for z in ([0.3, 0.1], [1e6, 0.1], [np.nan, 5.0], [np.nan, np.nan], None):
        before = support.snapshot(kf)
        likelihood = kf.log_likelihood
        x, P = kf.get_update(z)
        kf.get_prediction()
        kf.residual_of([1.0, 2.0])
        kf.log_likelihood_of(np.reshape([1.0, 2.0], kf.y.shape))
        support.assert_unchanged(before, kf)
        assert kf.log_likelihood == likelihood
        kf.update(z)
        support.assert_close(x, kf.x)
        support.assert_close(P, kf.P)


def test_what_get_update_and_get_prediction_return_can_be_written_to():
    kf = robust()
    before = support.snapshot(kf)
    for x, P in (kf.get_update([1.0, 2.0]), kf.get_update(None), kf.get_prediction()):
        x[:], P[:] = 77.0, 77.0
    support.assert_unchanged(before, kf)


@pytest.mark.parametrize("scaling", SCALINGS)
@pytest.mark.parametrize("ndim", NDIMS)
def test_update_correlated_is_the_correction_with_m(scaling, ndim):
    problem = mild()
    kf = robust(problem, ndim, scaling=scaling)
    z = [0.1, -20.0]
    reference = support.reference_correction(
        problem.x, problem.P, z, problem.H, problem.R, FORMULAS, scaling=scaling, M=problem.M
    )
    kf.update_correlated(z)
    check(kf, reference)


@pytest.mark.parametrize("ndim", NDIMS)
def test_update_sequential_is_one_correction_for_each_block(ndim):
    problem = support.random_problem(27, 4, 3)
    kf, x, P = robust(problem, ndim), problem.x, problem.P
    for rows, z in ((slice(0, 2), np.array([0.3, 80.0])), (slice(2, 3), np.array([-60.0]))):
        reference = support.reference_correction(x, P, z, problem.H[rows], problem.R[rows, rows], FORMULAS)
        kf.update_sequential(rows.start, z)
        x, P = reference.x, reference.P
        support.assert_close(np.ravel(kf.x), x, 1e-9, "x")
        support.assert_close(kf.P, P, 1e-9, "P")
        for name in ("y", "e", "weights"):
            support.assert_close(np.ravel(getattr(kf, name))[rows], getattr(reference, name), 1e-9, name)
        support.assert_close(kf.K[:, rows], reference.K, 1e-9, "K")
    assert kf.x.shape == ((4, 1) if ndim == 2 else (4,))


@pytest.mark.parametrize("ndim", NDIMS)
def test_steady_state_is_not_spoilt_by_the_outlier_before(ndim):
    problem = support.random_problem(28, 4, 2)
    calm, upset = robust(problem, ndim), robust(problem, ndim)
    zs = support.simulate(problem, 60, seed=1)[0]
    for kf in (calm, upset):
        for z in zs:
            kf.predict()
            kf.update(z)
        kf.predict()
    x, P = calm.x.copy(), calm.P.copy()
    calm.update(zs[0])
    upset.update([1e9, -1e9])
    support.assert_close(upset.K, calm.K)
    for kf in (calm, upset):
        kf.x, kf.P = x.copy(), P.copy()
        kf.predict_steadystate()
        kf.update_steadystate([0.4, 90.0])
        support.assert_close(kf.x_post, kf.x_prior + kf.K @ kf.y_bounded)
        e = np.ravel(kf.T @ kf.y)
        support.assert_close(np.ravel(kf.T @ kf.y_bounded), np.clip(e, -K, K), 1e-9)
        np.testing.assert_array_equal(np.ravel(kf.clipped), np.abs(e) > K)
    support.assert_close(calm.x, upset.x)


def test_steady_state_with_a_gain_from_elsewhere_is_bounded():
    problem = support.random_problem(28, 4, 2)
    donor = robust(problem)
    for z in support.simulate(problem, 60, seed=1)[0]:
        donor.predict()
        donor.update(z)
    kf = robust(problem)
    kf.K, kf.P = donor.K.copy(), donor.P.copy()
    kf.predict_steadystate()
    x = kf.x.copy()
    kf.update_steadystate([1e12, -1e12])
    assert 0 < np.abs(kf.x - x).max() < 100


@pytest.mark.parametrize("missing_first", [False, True])
def test_choices_can_be_changed_between_calls(missing_first):
    problem = mild()
    kf = robust(problem)
    if missing_first:
        kf.update(None)
    for scaling in SCALINGS:
        for grouping, information in COMPONENT + JOINT[1:]:
            for influence in (Huber(0.8), Huber(2.0)):
                choices = {"scaling": scaling, "grouping": grouping, "information": information}
                support.load(kf, problem)
                for name, value in {**choices, "influence": influence}.items():
                    setattr(kf, name, value)
                    assert getattr(kf, name) == value
                fresh = robust(problem, influence=influence, **choices)
                for one in (kf, fresh):
                    one.update([0.1, 30.0])
                support.assert_same_state(kf, fresh, ("x", "P", "K", "T", "e", "weights"), rtol=1e-14)


def test_defaults():
    kf = RobustKalmanFilter(2, 1)
    assert kf.influence == Huber(1.345)
    assert (kf.scaling, kf.information, kf.grouping) == ("innovation", "realized", "component")


@pytest.mark.parametrize("name", ["R", "H", "P", "F", "Q", "x"])
@pytest.mark.parametrize("ndim", NDIMS)
def test_writing_into_a_matrix_counts_from_the_next_call(name, ndim):
    """Trackers write into slices; nothing may be remembered from before."""
    problem = support.random_problem(29, 3, 2)
    written, fresh = robust(problem, ndim), robust(problem, ndim)
    for kf in (written, fresh):
        kf.predict()
        kf.update([0.1, 0.2])
    changed = getattr(fresh, name).copy()
    changed[0] = changed[0] * 1.5 + (0.0 if name in ("P", "Q", "R") else 0.1)
    if name in ("P", "Q", "R"):
        changed[:, 0] = changed[0]
    getattr(written, name)[:] = changed
    setattr(fresh, name, changed)
    for kf in (written, fresh):
        kf.predict()
        kf.update([0.3, 20.0])
    support.assert_same_state(written, fresh, rtol=1e-14)


def test_what_is_saved_does_not_share_memory():
    kf = robust()
    z = np.array([0.1, 0.2])
    kf.predict()
    kf.update(z)
    before = support.snapshot(kf, ("x_prior", "P_prior", "x_post", "P_post", "z"))
    kf.x[0], kf.P[0, 0], z[:] = 99.0, 99.0, 99.0
    support.assert_unchanged(before, kf)


def test_arguments_are_not_written_to():
    problem = support.random_problem(30, 3, 2, dim_u=1)
    kf = robust(problem)
    arguments = {name: getattr(problem, name).copy() for name in "FQBRH"} | {"u": np.ones((1, 1)), "z": np.ones((2, 1))}
    copies = {name: value.copy() for name, value in arguments.items()}
    for _ in range(3):
        kf.predict(arguments["u"], arguments["B"], arguments["F"], arguments["Q"])
        kf.update(arguments["z"], arguments["R"], arguments["H"])
    for name, value in arguments.items():
        np.testing.assert_array_equal(value, copies[name], err_msg=name)


def test_a_singular_s_is_said_and_a_pseudo_inverse_is_obeyed():
    problem = support.with_(
        support.cart(),
        H=np.array([[1.0, 0.0], [1.0, 0.0]]),
        R=1e-10 * np.eye(2),
        P=1e30 * np.eye(2),
        M=np.zeros((2, 2)),
    )
    kf = robust(problem)
    before = support.snapshot(kf)
    with pytest.raises(np.linalg.LinAlgError):
        kf.update([1.0, 1.0])
    support.assert_unchanged(before, kf)
    kf.inv = np.linalg.pinv
    kf.update([1.0, 1.0])
    support.assert_close(kf.T @ kf.T, np.linalg.pinv(kf.S), 1e-6)
    assert np.all(np.isfinite(kf.x))
    assert kf.x[0, 0] == pytest.approx(1.0, abs=1e-6)


def test_unit_scaling_refuses_to_make_p_indefinite():
    kf = robust(support.with_(support.cart(), P=10 * np.eye(2)), scaling="unit")
    before = support.snapshot(kf)
    assert issubclass(NotPositiveDefiniteError, np.linalg.LinAlgError)
    for call in (kf.update, kf.get_update, kf.update_correlated, lambda z: kf.update_sequential(0, z)):
        with pytest.raises(NotPositiveDefiniteError, match="H P H'"):
            call(0.5)
        support.assert_unchanged(before, kf)
    kf.scaling = "bounded"
    kf.update(0.5)
    support.assert_positive_definite(kf.P)


def test_comes_back_after_a_jump_of_the_state():
    """A level shift is not an outlier: P grows while the innovation is clipped, and the filter follows."""
    problem = support.with_(support.cart(), F=np.eye(2), H=np.array([[1.0, 0.0]]))
    kf, rng = robust(problem), np.random.default_rng(3)
    for level in (0.0, 30.0):
        for z in level + rng.normal(size=400):
            kf.predict()
            kf.update(z)
        assert abs(kf.x[0, 0] - level) < 2.0


def test_outliers_hurt_less_than_they_hurt_filterpy():
    problem = support.random_problem(31, 3, 2)
    dirty, _ = support.simulate(problem, 1500, seed=5, contamination=0.2, size=50.0)
    clean, _ = support.simulate(problem, 1500, seed=5)
    errors = {}
    for cls in (RobustKalmanFilter, KalmanFilter):
        kf, oracle = support.make(cls, problem), support.make(KalmanFilter, problem)
        dirty_x = kf.batch_filter(list(dirty[:, :, None]))[0]
        errors[cls] = np.mean((dirty_x - oracle.batch_filter(list(clean[:, :, None]))[0]) ** 2)
    assert errors[RobustKalmanFilter] < 0.1 * errors[KalmanFilter]


def test_repr_names_the_class_and_the_choices():
    text = repr(
        RobustKalmanFilter(2, 1, influence=Huber(1.5), scaling="bounded", information="weight", grouping="joint")
    )
    for part in ("RobustKalmanFilter", "Huber(threshold=1.5)", "bounded", "weight", "joint", "dim_x = 2"):
        assert part in text, part
    kf = robust()
    kf.predict()
    kf.update([1.0, 1e6])
    assert "y_bounded" in repr(kf)


def test_mahalanobis_distance_keeps_its_meaning_for_gates():
    kf = robust(influence=Huber())
    kf.update([30.0, -40.0])
    gate = support.make(KalmanFilter, support.random_problem(21, 4, 2))
    gate.update([30.0, -40.0])
    y = gate.y[:, 0]
    assert kf.mahalanobis == pytest.approx(np.sqrt(y @ np.linalg.inv(gate.S) @ y), rel=1e-9)
    assert kf.mahalanobis > 10


def test_linear_has_no_bound():
    """The other side of the coin, so that the bounds above can fail."""
    kf = robust(influence=Linear())
    kf.update([1e9, -1e9])
    assert np.abs(kf.x).max() > 1e6
    assert not kf.clipped.any()
