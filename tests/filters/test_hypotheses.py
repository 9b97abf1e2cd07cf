"""Filters that doubt the process too: exact on small mixtures, and asking them changes nothing."""

import itertools

import numpy as np
import pytest
import support
from filterpy.common import Saver
from filterpy.kalman import IMMEstimator, KalmanFilter
from scipy.special import logsumexp
from scipy.stats import multivariate_normal
from support import POLICIES, cart, make, noise_given, random_problem, simulate, through, two_sided, with_

from robust_filterpy import AdaptiveKalmanFilter, Contaminated, RobustKalmanFilter, robust
from robust_filterpy.correction import Scales

NONE = Contaminated(0.0)
BOTH = {"grouping": "joint", "noise": Contaminated(0.1, 10.0), "process": Contaminated(0.2, 6.0)}
KINDS = {name: options for name, options in POLICIES.items() if name != "learnt"}
KINDS |= {f"{name}, joint": {**options, "grouping": "joint"} for name, options in KINDS.items()} | {"matched": BOTH}


def exact_step(problem, z, process, noise):
    """One step, Q and R each times one of so many factors: mean, covariance, log p(z), the probability of each pair."""
    x, H, means, covariances, logs = problem.F @ problem.x[:, 0], problem.H, [], [], []
    for (share_q, q), (share_r, r) in itertools.product(process, noise):
        P = problem.F @ problem.P @ problem.F.T + q * problem.Q
        S, C = H @ P @ H.T + r * problem.R, P @ H.T
        means.append(x + C @ np.linalg.solve(S, z - H @ x))
        covariances.append(P - C @ np.linalg.solve(S, C.T))
        logs.append(np.log(share_q * share_r) + multivariate_normal.logpdf(z, H @ x, S))
    weights = np.exp(logs - logsumexp(logs))
    apart = means - weights @ means
    covariance = np.tensordot(weights, covariances, 1) + (weights * apart.T) @ apart
    return weights @ means, covariance, logsumexp(logs), weights.reshape(len(process), len(noise))


def first_shares(dwell):
    """How probable the scales 1, 10 and 100 are at the first step: at the start each as its inverse."""
    start = np.array([1.0, 0.1, 0.01])
    return start / start.sum() @ (np.full((3, 3), 0.5 / dwell) + (1.0 - 1.5 / dwell) * np.eye(3))


SCALES = list(zip(first_shares(50.0), (1.0, 10.0, 100.0), strict=True))
# How probable the classes of learnt noise are before anything has been seen.
CLASSES = [(0.85, 1.0), (0.05, 10.0), (0.05, 100.0), (0.05, 1000.0)]


@pytest.mark.parametrize("cls, dim_z, options, process, noise", [
    (noise_given, 2, BOTH, [(0.8, 1.0), (0.2, 36.0)], [(0.9, 1.0), (0.1, 100.0)]),
    (AdaptiveKalmanFilter, 2, {"grouping": "joint", "process": Scales((1.0, 10.0, 100.0), 50.0)}, SCALES, CLASSES),
    (AdaptiveKalmanFilter, 1, {"process": Scales((1.0, 10.0, 100.0), 50.0)}, SCALES, CLASSES),
], ids=["given", "learnt, joint", "learnt"])  # fmt: skip
@pytest.mark.parametrize("seed", range(5))
def test_one_step_is_the_exact_posterior_over_all_hypotheses(cls, dim_z, options, process, noise, seed):
    problem = random_problem(seed, 4, dim_z)
    z = simulate(problem, 1, seed, contamination=0.5, size=6.0)[0][0]
    mean, covariance, log_likelihood, probabilities = exact_step(problem, z, process, noise)
    kf = make(cls, problem, 1, **options)
    kf.predict()
    assert kf.log_likelihood_of(z) == pytest.approx(log_likelihood, rel=1e-9)
    kf.update(z)
    np.testing.assert_allclose(kf.x, mean, rtol=1e-9)
    np.testing.assert_allclose(kf.P, covariance, rtol=1e-8, atol=1e-10)
    assert kf.log_likelihood == pytest.approx(log_likelihood, rel=1e-9)
    assert kf.outlier_probability == pytest.approx(1.0 - probabilities[:, 0].sum(), rel=1e-8)
    np.testing.assert_allclose(kf.process_probabilities[:, 0], probabilities.sum(axis=1), rtol=1e-8)


def test_a_jump_that_nothing_denies_widens_P():
    """The scale of each step is drawn anew, so P is that of the mixture, measured or not."""
    problem = cart()
    kf, w = make(noise_given, problem, **BOTH), BOTH["process"]
    larger = (1 + w.contamination * (w.scale_ratio**2 - 1)) * problem.Q
    for z in (None, None, 0.5, None):
        P = problem.F @ kf.P @ problem.F.T + larger
        np.testing.assert_allclose(kf.get_prediction()[1], P, rtol=1e-12)
        kf.predict()
        np.testing.assert_allclose(kf.P, P, rtol=1e-12)
        kf.update(z)
        assert z is not None or ((kf.P == kf.P_prior).all() and kf.log_likelihood == 0.0)


@pytest.mark.parametrize("ndim", [1, 2])
@pytest.mark.parametrize("name", KINDS)
def test_looking_changes_nothing_and_says_what_a_call_would_do(name, ndim):
    problem = random_problem(2, 4, 2)
    kf = make(RobustKalmanFilter, problem, ndim, **KINDS[name])
    zs = simulate(problem, 6, 2, contamination=0.5)[0]
    through(kf, zs[:5])
    for z in (zs[5], [1e6, 0.1], [np.nan, 5.0], [np.nan, np.nan], None):
        kf.predict()
        _ = kf.log_likelihood, kf.likelihood, kf.y, kf.S, kf.SI, kf.mahalanobis
        before, memory = support.snapshot(kf), kf.state()
        x, P = kf.get_update(z)
        kf.get_prediction(), kf.get_update(None), kf.log_likelihood_of(z), kf.residual_of(zs[0].reshape(kf.y.shape))
        # What is handed out may be written into.
        for handed in (kf.get_update(z), kf.get_prediction()):
            handed[0][:], handed[1][:] = 77.0, 77.0
        assert repr(kf)
        support.assert_unchanged(before, kf)
        np.testing.assert_equal(kf.state(), memory)
        kf.update(z)
        np.testing.assert_array_equal(kf.x, x)
        np.testing.assert_array_equal(kf.P, P)
        x, P = kf.get_prediction()
    kf.predict()
    support.assert_close(kf.x, x, 1e-14)
    support.assert_close(kf.P, P, 1e-14)


@pytest.mark.parametrize("cls", [two_sided, AdaptiveKalmanFilter])
def test_a_process_scale_that_is_ruled_out_for_long_spoils_nothing(cls):
    """A dwell beyond 1/eps lets no probability back in; one that has underflowed is divided by."""
    kf = make(cls, cart(), 1, process=Scales((1.0, 1e6), dwell=1e20))
    through(kf, np.random.default_rng(0).normal(size=600))
    assert np.isfinite(kf.x).all() and kf.process_probabilities[0] == pytest.approx(1.0)


def test_two_sided_starts_over_from_an_assigned_state():
    problem = cart()
    kf = make(two_sided, problem, 1)
    through(kf, simulate(problem, 30, 0)[0])
    kf.x[0] += 50.0
    x = kf.x.copy()
    np.testing.assert_allclose(kf.get_prediction()[0], problem.F @ x)
    kf.P = 3.0 * np.eye(2)
    kf.predict()
    np.testing.assert_allclose(kf.x, problem.F @ x)
    np.testing.assert_allclose(kf.P, 3.0 * problem.F @ problem.F.T + kf.process_scale[0] * problem.Q)


def test_two_sided_with_a_linear_psi_is_filterpys_interacting_multiple_models():
    problem, scales, dwell = cart(), (1.0, 30.0, 100.0), 8.0
    process = Scales(scales, dwell, jump=0.0)
    ours = make(two_sided, problem, noise=NONE, process=process)
    moves = np.full((3, 3), 0.5 / dwell) + (1 - 1.5 / dwell) * np.eye(3)
    bank = [make(KalmanFilter, with_(problem, Q=s * problem.Q)) for s in scales]
    theirs = IMMEstimator(bank, process.begin, moves)
    for z in simulate(with_(problem, Q=9 * problem.Q), 60, 2)[0]:
        # Only after the update: what theirs shows between the two weighs the models by their old probabilities.
        ours.predict(), theirs.predict()
        ours.update(z), theirs.update(z)
        np.testing.assert_allclose(ours.process_probabilities[:, 0], theirs.mu, rtol=1e-8)
        np.testing.assert_allclose(ours.x, theirs.x, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(ours.P, theirs.P, rtol=1e-8)


# rts_smoother after a filter that doubts the process smooths with the process noise that the filter found.


LEVEL = support.with_(support.cart(), F=np.eye(2), Q=np.diag([0.01, 0.0]))
STEPS, JUMP = 60, 30


def recording():
    return np.where(np.arange(STEPS) < JUMP, 0.0, 12.0) + np.random.default_rng(0).normal(size=STEPS)


def doubting(kind):
    if kind is noise_given:
        noise = Contaminated(0.05, 100.0)
        return support.make(kind, LEVEL, noise=Contaminated(0.0), process=noise)
    return support.make(kind, LEVEL, noise=Contaminated(0.1, 5.0))


@pytest.mark.parametrize("kind", [noise_given, two_sided])
def test_it_is_filterpys_smoother_with_Q_times_the_scale_of_each_step(kind):
    zs = recording()
    kf, loop = doubting(kind), doubting(kind)
    Rs = [np.eye(1) * (1.0 + k % 2) for k in range(STEPS)]
    saver = Saver(kf)
    means, covariances, _, _ = kf.batch_filter(list(zs), Rs=Rs, saver=saver)
    assert len(saver.x) == STEPS
    by_kernel = doubting(kind)
    without = by_kernel.rts_smoother(*by_kernel.batch_filter(list(zs), Rs=Rs)[:2])
    scales, states, spreads = [], [], []
    for z, R in zip(zs, Rs, strict=True):
        support.predict_and_update(loop, z, R=R)
        scales.append(loop.process_scale)
        states.append(loop.x)
        spreads.append(loop.P)
    assert np.min(scales) >= 0.9 and np.max(scales) > 10.0
    by_hand = KalmanFilter.rts_smoother(
        loop, np.array(states), np.array(spreads), Qs=[np.outer(s, s) * LEVEL.Q for s in np.sqrt(scales)]
    )
    for one, other, kernels in zip(kf.rts_smoother(means, covariances), by_hand, without, strict=True):
        np.testing.assert_array_equal(one, other)
        np.testing.assert_allclose(kernels, other, rtol=1e-9, atol=1e-10)
    # Nominal Qs of each step are scaled as well.
    for one, other in zip(kf.rts_smoother(means, covariances, Qs=[LEVEL.Q] * STEPS), by_hand, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("kind", [noise_given, two_sided])
def test_states_of_another_recording_are_smoothed_with_the_Q_that_is_given(kind):
    zs = recording()
    kf = doubting(kind)
    kf.batch_filter(list(zs))
    other = doubting(kind)
    means, covariances, _, _ = other.batch_filter(list(zs[::-1]))
    expected = KalmanFilter.rts_smoother(kf, means, covariances)
    np.testing.assert_array_equal(kf.rts_smoother(means, covariances)[0], expected[0])
    with pytest.raises(TypeError, match="saver: expected"):
        kf.batch_filter(list(zs), saver=3)


@pytest.mark.parametrize("far", [5.0, 30.0, 300.0])
@pytest.mark.parametrize("set_later", [False, True])
def test_the_first_reading_of_a_filter_that_runs_contradicts_no_start(far, set_later):
    errors = np.zeros(2)
    for seed in range(10):
        rng, kf = np.random.default_rng(seed), KalmanFilter(2, 1)
        kf.F, kf.H, kf.Q, kf.P = np.array([[1.0, 0.1], [0.0, 1.0]]), np.eye(1, 2), 1e-4 * np.eye(2), 10.0 * np.eye(2)
        truth = np.cumsum(0.01 * rng.normal(size=260))
        zs = truth + rng.normal(size=260)
        for z in zs[:200]:
            kf.predict(), kf.update(z)
        ours = robust(kf) if set_later else robust(kf, noise="learnt")
        ours.noise = "learnt"
        zs[200] += far
        for k in range(200, 260):
            for i, one in enumerate((ours, kf)):
                one.predict(), one.update(zs[k])
                errors[i] += (np.ravel(one.x)[0] - truth[k]) ** 2
    # The doubt of a start cost 5.6 to 17 times the error.
    assert errors[0] < 0.95 * errors[1]
