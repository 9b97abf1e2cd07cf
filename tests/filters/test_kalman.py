"""Every correction of the robust filter is that of the paper, shows what it did, and bounds what an outlier does."""

import itertools

import numpy as np
import pytest
import scipy.stats
import support
from filterpy.kalman import KalmanFilter
from statsmodels.robust import norms

from robust_filterpy import Huber, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.correction import NotPositiveDefiniteError, SingularInnovationError
from robust_filterpy.influence import Hampel, Linear

pytestmark = pytest.mark.core

K = 1.345
SCALINGS = ["innovation", "bounded", "unit"]
GROUPED = [("component", information) for information in ("realized", "expected", "weight")]
GROUPED += [("joint", information) for information in ("realized", "weight")]
NDIMS = [1, 2]


def robust(problem=None, ndim=2, **choices):
    """A robust filter for the problem, or for one of four states and two sensors."""
    return support.make(RobustKalmanFilter, problem or support.random_problem(21, 4, 2), ndim, **choices)


ANY = [Huber(), Linear(), Huber(0.7), Hampel(), TukeyBiweight(), StudentT(2.5), norms.TukeyBiweight(), norms.Hampel()]
ANY += [norms.HuberT(2.0), norms.AndrewWave()]


@pytest.mark.pairwise
@pytest.mark.parametrize("influence", ANY, ids=[f"{k} {type(psi).__name__}" for k, psi in enumerate(ANY)])
@pytest.mark.parametrize("method", ["update", "update_correlated"])
@pytest.mark.parametrize("scaling", SCALINGS)
@pytest.mark.parametrize("grouping, information", GROUPED)
@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("dim_z", [1, 2, 3])
def test_update_is_the_correction_at_every_size_of_residual(
    method, scaling, grouping, information, ndim, dim_z, influence
):
    """With every influence, also the norms of statsmodels as they are."""
    problem, choices = support.mild(4, dim_z), {"scaling": scaling, "grouping": grouping, "information": information}
    M = problem.M if method == "update_correlated" else None
    # Of several that are exactly as predicted rounding would say which is the most plausible.
    for size in (0.0 if dim_z == 1 else 0.1, 0.5, 1.5, 3.0, 5.0, 9.0, 1e3):
        z = (problem.H @ problem.x)[:, 0] + size * np.array([1.0, -0.7, 0.41])[:dim_z]
        kf = robust(problem, ndim, influence=influence, **choices)
        reference = support.reference_correction(
            problem.x, problem.P, z, problem.H, problem.R, influence, M=M, **choices
        )
        getattr(kf, method)(z)
        support.assert_corrected(kf, reference, rtol=1e-7 if grouping == "joint" else 1e-9)
        assert np.isfinite(kf.log_likelihood) and kf.clipped.dtype == bool
        judged = np.full(dim_z, np.linalg.norm(reference.e)) if grouping == "joint" else reference.e
        np.testing.assert_array_equal(np.ravel(kf.clipped), influence.psi_deriv(judged) <= 0.0)


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


def test_as_it_is_built():
    kf, plain = RobustKalmanFilter(3, 2, 1), KalmanFilter(3, 2, 1)
    assert isinstance(kf, KalmanFilter)
    for name in (*support.STATE, "y", "K", "S", "SI", "F", "H", "Q", "R", "B", "M", "alpha", "inv", "dim_x", "dim_z"):
        expected = np.zeros((3, 2)) if name == "M" else getattr(plain, name)
        np.testing.assert_array_equal(getattr(kf, name), expected, err_msg=name)
    assert kf.log_likelihood == plain.log_likelihood and kf.likelihood == plain.likelihood
    kf.test_matrix_dimensions()
    assert (kf.influence, kf.scaling, kf.information, kf.grouping) == (Huber(1.345), "learnt", "realized", "component")
    assert np.all(np.isnan(kf.weights)) and not kf.clipped.any() and not kf.e.any() and not kf.y_bounded.any()
    assert kf.weights.shape == kf.clipped.shape == kf.e.shape == kf.y_bounded.shape == (2, 1) and kf.T.shape == (2, 2)
    text = repr(RobustKalmanFilter(2, 1, influence=Huber(1.5), scaling="bounded", information="weight"))
    for part in ("RobustKalmanFilter", "Huber(threshold=1.5)", "bounded", "weight", "component", "dim_x = 2"):
        assert part in text, part
    kf.update([1.0, 1e6])
    assert "spread" in repr(kf) and "weights" in repr(kf)


@pytest.mark.parametrize("missing_first", [False, True])
def test_choices_can_be_changed_between_calls(missing_first):
    problem = support.mild()
    kf = robust(problem)
    if missing_first:
        kf.update(None)
    for scaling, (grouping, information), psi in itertools.product(SCALINGS, GROUPED, (Huber(0.8), Huber(2.0))):
        choices = {"scaling": scaling, "grouping": grouping, "information": information, "influence": psi}
        support.load(kf, problem)
        for name, value in choices.items():
            setattr(kf, name, value)
        fresh = robust(problem, **choices)
        for one in (kf, fresh):
            one.update([0.1, 30.0])
        support.assert_same_state(kf, fresh, ("x", "P", "K", "T", "e", "weights"), rtol=1e-14)


def test_numbers_of_a_state_come_back_as_numbers():
    kf, other = robust(), robust()
    kf.Q, kf.R, kf.alpha = 0.5, 2.0, 1.02
    other.restore(kf.state())
    for name in ("Q", "R", "alpha"):
        assert type(getattr(other, name)) is float and getattr(other, name) == getattr(kf, name), name


def test_a_singular_s_is_said_and_a_pseudo_inverse_is_obeyed():
    H = np.array([[1.0, 0.0], [1.0, 0.0]])
    kf = robust(support.with_(support.cart(), H=H, R=1e-10 * np.eye(2), P=1e30 * np.eye(2), M=np.zeros((2, 2))))
    before = support.snapshot(kf)
    with pytest.raises(np.linalg.LinAlgError):
        kf.update([1.0, 1.0])
    support.assert_unchanged(before, kf)
    kf.inv = np.linalg.pinv
    kf.update([1.0, 1.0])
    support.assert_close(kf.SI, np.linalg.pinv(kf.S), 1e-12)
    assert np.all(np.isfinite(kf.x)) and kf.x[0, 0] == pytest.approx(1.0, abs=1e-6)


def test_under_noise_a_users_inverse_changes_nothing_and_a_singular_s_is_an_error():
    kf, other = (support.load(support.noise_given(2, 1), support.cart()) for _ in range(2))
    kf.inv = np.linalg.pinv
    kf.update(7.0)
    other.update(7.0)
    support.assert_close(kf.x, other.x, 1e-12)
    kf.P, kf.R = np.zeros((2, 2)), np.zeros((1, 1))
    with pytest.raises(SingularInnovationError, match="without noise="):
        kf.update(7.0)


PATHS = {
    "update": lambda kf, z: kf.update(z),
    "update with R and H": lambda kf, z: kf.update(np.reshape(z, kf.y.shape), R=kf.R + np.eye(2), H=kf.H + 0.1),
    "update_correlated": lambda kf, z: kf.update_correlated(z),
    "update_sequential": lambda kf, z: kf.update_sequential(0, np.array(z)),
    "update_steadystate": lambda kf, z: kf.update_steadystate(z),
    "batch_filter": lambda kf, z: kf.batch_filter([np.reshape(z, kf.y.shape)]),
    "batch_filter update_first": lambda kf, z: kf.batch_filter([np.reshape(z, kf.y.shape)], update_first=True),
}


POLICIES = {repr(psi): {"influence": psi} for psi in (Hampel(), TukeyBiweight(), StudentT())} | support.POLICIES
POLICIES |= {f"{name}, joint": {**POLICIES[name], "grouping": "joint"} for name in support.POLICIES}


@pytest.mark.pairwise
@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("policy", POLICIES)
def test_every_path_bounds_the_correction(path, ndim, policy):
    """Once clipped, a larger outlier moves the state no further."""
    problem, states = support.random_problem(26, 4, 2), []
    for size in (1e6, 1e12, 1e300):
        kf = support.make(RobustKalmanFilter, problem, ndim, **POLICIES[policy])
        support.through(kf, support.simulate(problem, 5, 1)[0])
        PATHS[path](kf, [size, -size])
        states.append((np.ravel(kf.x), kf.P))
        support.assert_positive_definite(kf.P)
        assert np.isfinite(kf.log_likelihood)
    # Under a given noise the limit of what is far is not a limit of psi: a thousandth is left of the size.
    left = 5e-3 if "given" in policy or "two-sided" in policy else 1e-4
    for x, P in states[1:]:
        np.testing.assert_allclose(x, states[0][0], rtol=left, atol=left)
        np.testing.assert_allclose(P, states[0][1], rtol=left, atol=left)


@pytest.mark.parametrize(("H", "R", "P", "grouping"), [
    ([[1.0, 0.0]], [[1.0]], 10.0, "component"),
    # H P H' is 1, or a sensor that sees nothing takes more from the others than there is: nothing would be left.
    ([[0.0, 0.0], [0.0, 1.0]], [[0.1, 0.0], [0.0, 0.1]], 1.0, "component"),
    ([[0.0, 0.0], [0.0, 1.0], [0.0, 1.0]], [[1.6625, 0.0, 1.25], [0.0, 0.1, 0.0], [1.25, 0.0, 1.1]], 1.0, "joint"),
])  # fmt: skip
def test_unit_scaling_refuses_to_make_p_indefinite(H, R, P, grouping):
    kf = support.of_matrices(RobustKalmanFilter, 1.0, H, R=R, P=P, scaling="unit", grouping=grouping)
    before, z = support.snapshot(kf), np.zeros(len(H))
    assert issubclass(NotPositiveDefiniteError, np.linalg.LinAlgError)
    for call in (kf.update, kf.get_update, kf.update_correlated, lambda z: kf.update_sequential(0, z)):
        with pytest.raises(NotPositiveDefiniteError):
            call(z)
        support.assert_unchanged(before, kf)
    kf.scaling = "bounded"
    kf.update(z)
    support.assert_positive_definite(kf.P)


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


@pytest.mark.parametrize("first", [1.5e-14, -1e-13, 1e-11])
def test_a_first_innovation_of_rounding_is_not_typical(first):
    """The state was set from the first reading, by way of a computation, and that reading is then taken once more."""
    zs = 100.0 + 0.3 * np.arange(60) + np.random.default_rng(0).normal(size=60)
    found = []
    for off in (0.0, first):
        kf = robust(support.with_(support.cart(), x=np.array([[zs[0]], [0.0]]), P=10.0 * np.eye(2)), scaling="learnt")
        kf.update(zs[0] + off)
        found.append(kf.batch_filter(zs[1:])[0])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9)


def test_the_first_innovation_is_a_typical_one():
    kf = RobustKalmanFilter(1, 1)
    kf.H[:] = 1.0
    support.predict_and_update(kf, 3.0)
    # A median of a single |e| with S = 3, in units of a normal deviation.
    assert kf.spread == pytest.approx([3.0 / np.sqrt(3.0) / scipy.stats.norm.ppf(0.75)])
