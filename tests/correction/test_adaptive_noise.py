"""Learnt noise as pure functions: the scalar step is the general one, the counts are those of a Markov chain."""

import itertools
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from support import random_problem

from robust_filterpy.correction.adaptive import NoiseClasses, correct_adaptively
from robust_filterpy.correction.adaptive_noise import DECADES, class_probabilities, describe, learn, start
from robust_filterpy.correction.merging import Hypothesis, collapse, correct_each, merge


def weigh(p, scales, r, y, h, R):
    """The correction for one sensor in floats, from the definition; p becomes the probabilities given y.

    Score -d log p(y)/dy, its derivative, log p(y), and E[v^2 | y, class 0]/R; y is shortened to 8 standard deviations.
    """
    K = len(p)
    reach = 8.0 * math.sqrt(h + r * scales[K - 1] * R)
    y = min(max(y, -reach), reach)
    peak = -math.inf
    for k in range(K):
        S = h + r * scales[k] * R
        peak = max(peak, math.log(p[k]) - 0.5 * (y * y / S + math.log(S)))
    total = 0.0
    for k in range(K):
        S = h + r * scales[k] * R
        p[k] = math.exp(math.log(p[k]) - 0.5 * (y * y / S + math.log(S)) - peak)
        total += p[k]
    first, second = 0.0, 0.0
    for k in range(K):
        p[k] /= total
        S = h + r * scales[k] * R
        first += p[k] / S
        second += p[k] / S / S
    S = h + r * R
    energy = (r * y / S) ** 2 * R + r * h / S
    log_density = peak + math.log(total) - 0.5 * math.log(2.0 * math.pi)
    return first * y, first - y * y * (second - first * first), log_density, energy


def scalar_steps(ys, h=0.5, R=2.0, functions=(class_probabilities, weigh, learn), as_list=False):
    """Feed innovations to the three functions; return what each step gives, and what was learnt."""
    class_probabilities, weigh, learn = functions
    kind = (lambda a: a.tolist()) if as_list else (lambda a: a)
    known, begin, scales, found = kind(start(4)), kind(start(4)), np.array(DECADES), []
    for y in ys:
        p = kind(np.zeros(4))
        class_probabilities(known, p)
        result = weigh(p, scales, known[0], y, h, R)
        learn(known, begin, scales, p, result[3], 300.0, 30.0)
        found.append([*result, *p])
    return np.array(found), np.array(known)


@pytest.mark.parametrize("grouping", ["joint", "component"])
def test_for_one_sensor_the_scalar_functions_are_the_step(grouping):
    rng = np.random.default_rng(0)
    problem, classes = random_problem(0, 3, 1), NoiseClasses(grouping=grouping)
    x, P, H, R = problem.x[:, 0], problem.P, problem.H, problem.R
    zs = rng.standard_normal(60) * np.where(rng.random(60) < 0.2, 30.0, 1.0)
    learnt, known, begin, p = classes.start(1), start(4), start(4), np.zeros(4)
    for z in zs:
        step = correct_adaptively(x[None], P[None], np.ones(1), learnt, np.array([z]), H, R, classes)
        class_probabilities(known, p)
        h, C = (H @ P @ H.T).item(), P @ H[0]
        score, information, log_density, energy = weigh(p, DECADES, known[0], z - (H @ x).item(), h, R.item())
        learn(known, begin, DECADES, p, energy, classes.memory, classes.r_memory)
        assert_allclose(step.means[0], x + C * score, rtol=1e-9, atol=1e-12)
        assert_allclose(step.covariances[0], P - information * np.outer(C, C), rtol=1e-8, atol=1e-12)
        assert_allclose(step.learnt[0], known, rtol=1e-9)
        assert step.log_density == pytest.approx(log_density)
        assert step.outlier_probabilities[0] == pytest.approx(1.0 - p[0], abs=1e-12)
        learnt, x, P = step.learnt, problem.F @ step.means[0], problem.F @ step.covariances[0] @ problem.F.T + problem.Q


def test_lists_and_arrays_give_the_same():
    ys = np.random.default_rng(1).standard_normal(30) * 5.0
    for one, two in zip(scalar_steps(ys), scalar_steps(ys, as_list=True), strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.slow
def test_numba_compiles_the_functions_unchanged():
    numba = pytest.importorskip("numba")
    ys = np.random.default_rng(1).standard_normal(30) * 5.0
    compiled = scalar_steps(ys, functions=[numba.njit(f) for f in (class_probabilities, weigh, learn)])
    for one, two in zip(scalar_steps(ys), compiled, strict=True):
        assert_allclose(one, two, rtol=1e-12)


def test_score_and_information_are_derivatives_of_the_log_density():
    def log_density(y):
        p = np.array([0.6, 0.2, 0.1, 0.1])
        return weigh(p, DECADES, 1.7, y, 0.5, 2.0)

    for y in (0.0, 1.3, -6.0, 25.0, 80.0):
        h = 1e-4 * max(1.0, abs(y))
        below, at, above = (log_density(y + s * h) for s in (-1.0, 0.0, 1.0))
        assert at[0] == pytest.approx(-(above[2] - below[2]) / (2 * h), rel=1e-6, abs=1e-9)
        assert at[1] == pytest.approx((above[0] - below[0]) / (2 * h), rel=1e-5, abs=1e-9)
    assert quad(lambda y: np.exp(log_density(y)[2]), -400, 400, points=[0.0], limit=200)[0] == pytest.approx(1.0)


def test_energy_is_the_mean_square_of_the_noise_given_the_innovation():
    """Of v and H x: y = H x + v, both normal; by integration."""
    r, h, R, y = 1.7, 0.5, 2.0, 3.1
    density = [lambda v: np.exp(-0.5 * (v**2 / (r * R) + (y - v) ** 2 / h))]
    total = quad(density[0], -20, 20, points=[0.0, y])[0]
    square = quad(lambda v: v * v * density[0](v), -20, 20, points=[0.0, y])[0]
    energy = weigh(np.array([1.0]), [1.0], r, y, h, R)[3]
    assert energy == pytest.approx(square / total / R, rel=1e-8)


def test_the_prior_is_a_stationary_chain():
    p = np.zeros(4)
    class_probabilities(start(4), p)
    assert_allclose(p, [0.85, 0.05, 0.05, 0.05], rtol=1e-12)
    assert_allclose(start(1)[2:], [1.0, 1.0, 10.0])


def test_transitions_are_counted_with_a_memory():
    """Classes that are certain: counts = prior + sum of forgotten ones."""
    K, memory, rng = 3, 20.0, np.random.default_rng(2)
    known, begin = start(K), start(K)
    labels = np.concatenate([[0], rng.choice(K, 60, p=[0.8, 0.1, 0.1])])
    known[2 + K : 2 + 2 * K] = np.eye(K)[0]
    counts = np.zeros((K, K))
    for before, now in itertools.pairwise(labels):
        learn(known, begin, [1.0, 10.0, 100.0], np.eye(K)[now].copy(), 1.0, memory, 30.0)
        counts *= 1.0 - 1.0 / memory
        counts[before, now] += 1.0
    assert_allclose(known[2 + 2 * K :].reshape(K, K), begin[2 + 2 * K :].reshape(K, K) + counts, rtol=1e-10)


def test_when_ordinary_samples_are_few_r_starts_from_the_class_of_the_median():
    known, begin = start(4), start(4)
    known[0] = 0.3
    for _ in range(200):
        learn(known, begin, DECADES, np.array([0.05, 0.15, 0.75, 0.05]), 1.0, 300.0, 30.0)
        if known[0] > 10.0:
            break
    # Class 2 had 100 times the variance; everything else is as before the first sample.
    assert 10.0 < known[0] < 100.0
    assert_allclose(known[1:], begin[1:])


def test_describe_reads_a_chain_that_is_known():
    """Outliers a tenth of the time, in runs of five, of class 2."""
    counts = np.zeros((4, 4))
    counts[2, 2], counts[2, 0], counts[0, 2], counts[0, 0] = 80.0, 20.0, 20.0, 880.0
    learnt = np.concatenate([[4.0, 16.0], np.zeros(8), counts.ravel()])[None]
    noise = describe(learnt, np.array(DECADES))
    assert noise.contamination[0] == pytest.approx(0.1) and noise.run_length[0] == pytest.approx(5.0)
    assert noise.scale_ratio[0] == pytest.approx(10.0)
    assert noise.r[0] == 4.0 and noise.r_std[0] == pytest.approx(1.0)
    # The variance of a share of correlated samples: (1 + rho)/(1 - rho) times the independent ones'.
    rho = 0.8 - 20.0 / 900.0
    assert noise.contamination_std[0] == pytest.approx(np.sqrt(0.09 / 1001 * (1 + rho) / (1 - rho)))
    assert describe(learnt, np.array(DECADES), sensors=4).r_std[0] == pytest.approx(0.5)


def test_the_order_of_independent_sensors_is_that_of_plausibility():
    """Two good sensors agree; a wild one is looked at last, so it cannot mislead the others' classes."""
    H, R, classes = np.ones((3, 1)), np.eye(3), NoiseClasses()
    args = (np.zeros((1, 1)), 4.0 * np.eye(1)[None], np.ones(1), classes.start(3))
    step = correct_adaptively(*args, np.array([25.0, 0.3, -0.2]), H, R, classes)
    other = correct_adaptively(*args, np.array([0.3, -0.2, 25.0]), H, R, classes)
    assert_allclose(step.outlier_probabilities, other.outlier_probabilities[[2, 0, 1]])
    assert step.outlier_probabilities[0] > 0.99 and step.outlier_probabilities[1:].max() < 0.1
    assert_allclose(step.means, other.means)


def test_sensors_with_correlated_noise_tell_of_each_other():
    """One class each, whose size has been learnt: the Kalman filter with the full R and M, scaled."""
    rng = np.random.default_rng(3)
    problem, classes = random_problem(3, 4, 3), NoiseClasses(scales=[1.0])
    x, P, H, z, learnt = problem.x[:, 0], problem.P, problem.H, rng.standard_normal(3), classes.start(3)
    learnt[:, 0] = r = np.array([4.0, 0.3, 1.7])
    R, M = np.sqrt(np.outer(r, r)) * problem.R, 0.5 * np.sqrt(r) * problem.M
    step = correct_adaptively(x[None], P[None], np.ones(1), learnt, z, H, problem.R, classes, 0.5 * problem.M)
    S, C, y = H @ P @ H.T + R + H @ M + (H @ M).T, P @ H.T + M, z - H @ x
    assert_allclose(step.means[0], x + C @ np.linalg.solve(S, y), rtol=1e-8)
    assert_allclose(step.covariances[0], P - C @ np.linalg.solve(S, C.T), rtol=1e-7, atol=1e-10)
    density = -0.5 * (y @ np.linalg.solve(S, y) + np.linalg.slogdet(2 * np.pi * S)[1])
    assert step.log_density == pytest.approx(density)


def test_collapse_and_merge_are_the_moments_of_a_sample():
    rng = np.random.default_rng(4)
    shares, means, roots = np.array([0.2, 0.5, 0.3]), rng.normal(size=(3, 2)), rng.normal(size=(3, 2, 2))
    covariances = roots @ roots.transpose(0, 2, 1)
    mean, covariance = collapse(shares, means, covariances)
    labels = rng.choice(3, 200_000, p=shares)
    sample = means[labels] + (roots[labels] @ rng.normal(size=(len(labels), 2, 1)))[..., 0]
    error = 5.0 * np.sqrt(np.diag(covariance) / len(labels))
    assert (np.abs(sample.mean(axis=0) - mean) < error).all()
    assert_allclose(np.cov(sample.T), covariance, atol=5 * np.abs(covariance).max() * np.sqrt(4 / len(labels)))


def test_leading_axes_are_independent_corrections():
    rng = np.random.default_rng(5)
    H, roots = rng.normal(size=(2, 3)), rng.normal(size=(4, 1, 3, 3))
    P = roots @ np.swapaxes(roots, -1, -2) + np.eye(3)
    R = np.array([1.0, 100.0])[:, None, None] * np.eye(2)
    y = rng.normal(size=(4, 1, 2)) * 3.0
    each = correct_each(y, P, H, R)
    assert each.moves.shape == (4, 2, 3) and each.log_densities.shape == (4, 2)
    for q in range(4):
        merged = merge(np.zeros(3), y[q, 0], H, [Hypothesis(0.9, P[q, 0], R[0]), Hypothesis(0.1, P[q, 0], R[1])])
        logs = np.log([0.9, 0.1]) + each.log_densities[q]
        assert merged.log_density == pytest.approx(np.logaddexp(*logs))
        weights = np.exp(logs - merged.log_density)
        assert_allclose(merged.x, weights @ each.moves[q], rtol=1e-9)


@pytest.mark.parametrize("options", [{"scales": [1.0, 0.5]}, {"grouping": "each"}, {"memory": 0.5}, {"r_memory": "x"}])
def test_bad_classes_are_refused(options):
    with pytest.raises((ValueError, TypeError), match="expected"):
        NoiseClasses(**options)
