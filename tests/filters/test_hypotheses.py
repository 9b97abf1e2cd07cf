"""Filters that doubt the process too: exact on small mixtures, and the guarantees of every filter here."""

import itertools

import numpy as np
import pytest
import support
from filterpy.kalman import IMMEstimator, KalmanFilter
from scipy.special import logsumexp
from scipy.stats import multivariate_normal
from support import FILTERPY_2, cart, make, paper_problem, random_problem, simulate, told, two_sided, with_

from robust_filterpy import AdaptiveKalmanFilter, Contaminated, RobustExtendedKalmanFilter, RobustKalmanFilter, StudentT
from robust_filterpy.correction import Scales

NONE = Contaminated(0.0)
BOTH = {"grouping": "joint", "noise": Contaminated(0.1, 10.0), "process": Contaminated(0.2, 6.0)}
KINDS = [
    pytest.param(RobustKalmanFilter, {}, id="default"),
    pytest.param(RobustKalmanFilter, {"grouping": "joint", "scaling": "innovation"}, id="joint"),
    pytest.param(told, BOTH, id="matched"),
    pytest.param(told, {**BOTH, "grouping": "component"}, id="matched-component"),
    pytest.param(two_sided, {}, id="two-sided"),
    pytest.param(two_sided, {"grouping": "joint"}, id="two-sided-joint"),
    pytest.param(AdaptiveKalmanFilter, {"grouping": "joint"}, id="adaptive-joint"),
    pytest.param(AdaptiveKalmanFilter, {}, id="adaptive"),
]


def advance(kf, zs, **call):
    path = []
    for z in zs:
        kf.predict()
        kf.update(z, **call)
        path.append(np.ravel(kf.x).copy())
    return np.array(path)


@pytest.mark.parametrize("cls, options", [
    (told, {"noise": NONE, "process": NONE, "grouping": "joint"}),
    (told, {"noise": NONE, "process": Scales([1.0], jump=0.0), "grouping": "joint"}),
    (told, {"noise": NONE, "process": Scales([1.0, 1.0], dwell=5, jump=0.0), "grouping": "joint"}),
])  # fmt: skip
@pytest.mark.parametrize("ndim", [1, 2])
@pytest.mark.parametrize("method", ["update", "update_correlated"])
def test_equals_kalman_for_ordinary_noise(cls, options, ndim, method):
    if method == "update_correlated" and not FILTERPY_2:
        pytest.skip("1.4.5 has M of the wrong shape")
    problem = random_problem(1, 4, 2, 1)
    ours, theirs = make(cls, problem, ndim, **options), make(KalmanFilter, problem, ndim)
    u = np.array([0.3]) if ndim == 1 else np.array([[0.3]])
    for z in simulate(problem, 200, 1)[0]:
        for kf in (ours, theirs):
            kf.predict(u=u)
            getattr(kf, method)(z if ndim == 1 else z[:, None])
        for name in ("x", "P", "y", "S", "SI", "K", "x_prior", "P_prior", "log_likelihood", "mahalanobis")[
            : 10 if FILTERPY_2 else 9
        ]:
            np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-8, atol=1e-10, err_msg=name)
            assert np.shape(getattr(ours, name)) == np.shape(getattr(theirs, name)), name


def brute_force(problem, z, both):
    """Mean, covariance and log p(z) over the four hypotheses of one step, each by conditioning a joint normal."""
    v, w = both["noise"], both["process"]
    x0 = problem.F @ problem.x[:, 0]
    means, covs, logs = [], [], []
    for jump, bad in itertools.product((False, True), repeat=2):
        P = problem.F @ problem.P @ problem.F.T + problem.Q * (w.scale_ratio**2 if jump else 1)
        R = problem.R * (v.scale_ratio**2 if bad else 1)
        S, C, H = problem.H @ P @ problem.H.T + R, P @ problem.H.T, problem.H
        prior = (w.contamination if jump else 1 - w.contamination) * (v.contamination if bad else 1 - v.contamination)
        means.append(x0 + C @ np.linalg.solve(S, z - H @ x0))
        covs.append(P - C @ np.linalg.solve(S, C.T))
        logs.append(np.log(prior) + multivariate_normal.logpdf(z, H @ x0, S))
    probability = np.exp(logs - logsumexp(logs))
    mean = probability @ means
    spread = sum(s * np.outer(m - mean, m - mean) for s, m in zip(probability, means, strict=True))
    return (
        mean,
        np.tensordot(probability, covs, 1) + spread,
        logsumexp(logs),
        probability[1] + probability[3],
        probability[2] + probability[3],
    )


@pytest.mark.parametrize("seed", range(5))
def test_one_step_is_the_exact_posterior_of_four_hypotheses(seed):
    problem = random_problem(seed, 4, 2)
    z = simulate(problem, 1, seed, contamination=0.5, size=6.0)[0][0]
    mean, cov, log_likelihood, bad, jumped = brute_force(problem, z, BOTH)
    kf = make(told, problem, 1, **BOTH)
    kf.predict()
    x, P = kf.get_update(z)
    assert kf.log_likelihood_of(z) == pytest.approx(log_likelihood, rel=1e-9)
    kf.update(z)
    for found in (x, kf.x):
        np.testing.assert_allclose(found, mean, rtol=1e-9)
    for found in (P, kf.P):
        np.testing.assert_allclose(found, cov, rtol=1e-8, atol=1e-10)
    assert kf.log_likelihood == pytest.approx(log_likelihood, rel=1e-9)
    assert kf.outlier_probability == pytest.approx(bad, rel=1e-8)
    assert kf.process_probabilities[1, 0] == pytest.approx(jumped, rel=1e-8)
    # What the measurement has spoken about is over.
    w = BOTH["process"]
    larger = (1 + w.contamination * (w.scale_ratio**2 - 1)) * problem.Q
    np.testing.assert_allclose(kf.get_prediction()[1], problem.F @ kf.P @ problem.F.T + larger, rtol=1e-12)


def test_a_jump_that_nothing_denies_widens_P():
    """The scale of each step is drawn anew, so P is that of the mixture, measured or not."""
    problem = cart()
    kf, w = make(told, problem, **BOTH), BOTH["process"]
    larger = (1 + w.contamination * (w.scale_ratio**2 - 1)) * problem.Q
    P = problem.P
    for _ in range(3):
        kf.predict()
        P = problem.F @ P @ problem.F.T + larger
        np.testing.assert_allclose(kf.P, P)
        kf.update(None)
        np.testing.assert_allclose(kf.P, P)
        assert kf.log_likelihood == 0.0


@pytest.mark.parametrize("ndim", [1, 2])
@pytest.mark.parametrize("cls, options", KINDS)
def test_looking_changes_nothing_and_says_what_a_call_would_do(cls, options, ndim):
    problem = random_problem(2, 4, 2)
    kf = make(cls, problem, ndim, **options)
    zs = simulate(problem, 6, 2, contamination=0.5)[0]
    advance(kf, zs[:5])
    for z in (zs[5], [1e6, 0.1], [np.nan, 5.0], [np.nan, np.nan], None):
        kf.predict()
        _ = kf.log_likelihood, kf.likelihood, kf.y, kf.S, kf.SI, kf.mahalanobis
        before, memory = support.snapshot(kf), kf.state()
        x, P = kf.get_update(z)
        kf.get_prediction(), kf.get_update(None), kf.log_likelihood_of(z), kf.residual_of(zs[0].reshape(kf.y.shape))
        # What is handed out may be written into.
        for found in (kf.get_update(z), kf.get_prediction()):
            found[0][:], found[1][:] = 77.0, 77.0
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


@pytest.mark.parametrize("cls, options", KINDS)
def test_every_path_that_corrects_is_robust(cls, options):
    problem = with_(paper_problem(), H=np.eye(2, 4), R=0.1 * np.eye(2), M=np.zeros((4, 2)))
    zs = np.random.default_rng(0).normal(size=(30, 2)) * 0.3
    for path in ("update", "correlated", "sequential", "steady"):
        kf = make(cls, problem, 1, **options)
        advance(kf, zs)
        if path == "steady":
            kf.predict_steadystate()
            before = kf.x.copy()
            kf.update_steadystate([1e6, 0.0])
        else:
            kf.predict()
            before = kf.x.copy()
            correct = {"update": kf.update, "correlated": kf.update_correlated}.get(path)
            correct([1e6, 0.0]) if correct else kf.update_sequential(0, [1e6])
        assert 0 <= np.abs(kf.x - before).max() < 2.0, path
        assert np.isfinite(kf.log_likelihood) and np.linalg.eigvalsh(kf.P)[0] > 0, path


@pytest.mark.parametrize("cls", [two_sided, AdaptiveKalmanFilter])
def test_a_process_scale_that_is_ruled_out_for_long_spoils_nothing(cls):
    """A dwell beyond 1/eps lets no probability back in; one that has underflowed is divided by."""
    kf = make(cls, cart(), 1, process=Scales((1.0, 1e6), dwell=1e20))
    support.through(kf, np.random.default_rng(0).normal(size=600))
    assert np.isfinite(kf.x).all() and kf.process_probabilities[0] == pytest.approx(1.0)


def test_two_sided_starts_over_from_an_assigned_state():
    problem = cart()
    kf = make(two_sided, problem, 1)
    advance(kf, simulate(problem, 30, 0)[0])
    kf.x[0] += 50.0
    x = kf.x.copy()
    np.testing.assert_allclose(kf.get_prediction()[0], problem.F @ x)
    kf.P = 3.0 * np.eye(2)
    kf.predict()
    np.testing.assert_allclose(kf.x, problem.F @ x)
    scales = kf.process_scale[0]
    np.testing.assert_allclose(kf.P, 3.0 * problem.F @ problem.F.T + scales * problem.Q)


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


@pytest.mark.parametrize("make_it, error, words", [
    (lambda: Contaminated(1.0), ValueError, "contamination: expected"),
    (lambda: Contaminated(0.1, 0.5), ValueError, "scale_ratio: expected"),
    (lambda: Contaminated("a"), TypeError, "contamination: expected"),
    (lambda: RobustKalmanFilter(2, 1, noise=0.1), TypeError, "noise: expected"),
    (lambda: RobustKalmanFilter(2, 1, noise="learned"), ValueError, "noise: expected"),
    (lambda: RobustKalmanFilter(2, 1, noise=NONE, process=StudentT()), TypeError, "process: expected"),
    (lambda: RobustKalmanFilter(2, 1, process="scales"), ValueError, "noise='learnt'"),
    (lambda: RobustKalmanFilter(2, 1, noise="learnt", patience=12), ValueError, "jump="),
    (lambda: RobustKalmanFilter(2, 1, scaling="learnt", patience=12), ValueError, "leave one of the two out"),
    (lambda: RobustKalmanFilter(2, 1, noise="learnt", influence=StudentT()), ValueError, "influence: expected none"),
    (lambda: RobustKalmanFilter(2, 1, noise="learnt", scaling="unit"), ValueError, "scaling: expected none"),
    (lambda: RobustKalmanFilter(2, 2, noise="learnt", grouping=((0,), (0,))), ValueError, "grouping: expected"),
    (lambda: RobustExtendedKalmanFilter(2, 1, noise="learnt", process="scales"), ValueError, "linear models"),
    (lambda: setattr(told(2, 1), "scaling", "unit"), AttributeError, "follows from noise="),
    (lambda: setattr(RobustKalmanFilter(2, 1), "process", "scales"), ValueError, "noise='learnt'"),
    (lambda: setattr(RobustKalmanFilter(2, 1), "learnt", np.zeros((1, 30))), AttributeError, "noise=Learnt"),
], ids=range(16))  # fmt: skip
def test_choices_that_make_no_sense_together_are_refused_in_words(make_it, error, words):
    with pytest.raises(error, match=words):
        make_it()
