"""Unknown outputs among neighbors, predictions through outliers: the numbers of the plain algebra."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from robust_filterpy import ARX, Contaminated
from robust_filterpy.correction.contaminated import START
from robust_filterpy.identification.estimation.missing import Unknowns, found_outliers
from robust_filterpy.identification.models.model import cleaned_residuals
from robust_filterpy.identification.models.noise import Noise
from robust_filterpy.identification.models.polynomial_model import Parts, PolynomialModel


def _problem(rng, samples, length, share, gap):
    """Return a response, unknown samples, weights, residuals, and the dense matrix of all samples."""
    h = np.concatenate(([1.0], rng.normal(size=length - 1) * 0.8 ** np.arange(1, length)))
    first = length - 1
    unknown = rng.random(samples + first) < share
    unknown[40 : 40 + gap] = True
    weights = rng.uniform(0.2, 1.0, samples)
    H = np.array([lfilter(h, [1.0], row)[first:] for row in np.eye(samples + first)]).T
    return h, first, unknown, weights, rng.normal(size=samples), H


@pytest.mark.parametrize(("length", "share", "gap"), [(1, 0.2, 0), (3, 0.1, 0), (3, 0.4, 30), (25, 0.1, 12)])
def test_unknown_samples_are_those_of_least_squares(length, share, gap):
    h, first, unknown, weights, base, H = _problem(np.random.default_rng(1), 300, length, share, gap)
    found, X = Unknowns(base, h, unknown, weights, first), H[:, unknown]
    covariance = np.linalg.inv(X.T @ (X * weights[:, None]) + 1e-9 * np.eye(X.shape[1]))
    correction = -covariance @ X.T @ (weights * base)
    np.testing.assert_allclose(found.correction, correction, atol=1e-6 * np.abs(correction).max())
    np.testing.assert_allclose(found.residual, base + X @ correction, atol=1e-6)
    np.testing.assert_allclose(found.leverages(), np.einsum("ki,ij,kj->k", X, covariance, X) * weights, atol=1e-6)
    deviation, precision = found.deviations()
    for k in range(0, unknown.size, 7):
        # All but this sample and the unknown ones are taken as they are.
        others = np.append(np.flatnonzero(unknown & (np.arange(unknown.size) != k)), k)
        Y = H[:, others]
        normal = Y.T @ (Y * weights[:, None])
        if np.linalg.cond(normal) < 1e8:
            whole = np.linalg.inv(normal)
            moved = -whole @ Y.T @ (weights * base)
            assert precision[k] == pytest.approx(1.0 / whole[-1, -1], rel=1e-4)
            assert deviation[k] == pytest.approx((1.0 if unknown[k] else -1.0) * moved[-1], rel=1e-4, abs=1e-6)


def test_the_uncertainty_of_unknown_samples_is_summed_over_all_of_them():
    h, first, unknown, weights, base, H = _problem(np.random.default_rng(2), 1500, 4, 0.45, 0)
    places, X = np.flatnonzero(unknown) - first, H[:, unknown]
    assert places.size > 600
    covariance = np.linalg.inv(X.T @ (X * weights[:, None]) + 1e-9 * np.eye(places.size))
    K = np.zeros((4, 4))
    for k, weight in enumerate(weights):
        near = np.flatnonzero((places <= k) & (places > k - 4))
        at = k - places[near]
        K[np.ix_(at, at)] += weight * covariance[np.ix_(near, near)]
    np.testing.assert_allclose(Unknowns(base, h, unknown, weights, first).spread(), K, rtol=1e-5)


@pytest.mark.parametrize(
    ("a", "c", "d", "gap"),
    [([-1.5, 0.7], [], [], 0), ([-0.5], [0.6], [], 200), ([], [0.3], [-0.9], 20), ([-1.2, 0.3, 0.1], [], [0.4], 0)],
)
def test_predictions_made_together_are_those_made_one_by_one(a, c, d, gap):
    rng, samples = np.random.default_rng(3), 2500
    parts = Parts(*(np.array(p) for p in ([1.0, *a], [], [1.0], [1.0, *c], [1.0, *d])), 0.0, np.zeros(0))
    error = lfilter(parts.c, parts.d, rng.normal(size=samples))
    wild = np.where(rng.random(samples) < 0.05, 30.0, 0.0) * rng.normal(size=samples)
    error += np.convolve(wild, parts.a)[:samples]
    known = np.ones(samples, dtype=bool)
    known[700 : 700 + gap] = False
    noise = Noise(Contaminated(0.05, 30.0), 1.0, given=True)
    found = cleaned_residuals(parts, error, known, noise)
    g = np.convolve(parts.a, parts.d)[1:]
    order = max(g.size, len(c))
    g, c = (np.concatenate((p, np.zeros(order - len(p)))) for p in (g, c))
    limit = np.sum(lfilter(np.append(1.0, c), np.append(1.0, g), np.append(1.0, np.zeros(500))) ** 2)
    driving, r, w, agrees = lfilter(parts.d, [1.0], error), *np.zeros((3, samples))
    variance = np.ones(samples)
    for k in range(samples):
        before = k - 1 - np.arange(min(order, k))
        j = np.arange(before.size)
        r[k] = driving[k] - np.sum((g[j] * (1.0 - w[before]) + c[j] * w[before]) * r[before])
        added = (g[j] - c[j]) ** 2 * (1.0 - w[before]) ** 2 * variance[before]
        variance[k] = min(1.0 + added.sum(), limit)
        explained = r[k] + np.sum((g[j] - c[j]) * (1.0 - w[before]) * r[before])
        agrees[k] = noise.weights(explained) if known[before].all() else 0.0
        lasts = min(agrees[k], agrees[k - 1] if k else 1.0)
        w[k] = max(noise.weights(r[k] / np.sqrt(variance[k])), lasts) if known[k] else 0.0
    np.testing.assert_allclose(found.residual, r, atol=1e-6)
    np.testing.assert_allclose(found.weights, w, atol=1e-6)


def _summed_up(seed, samples=400):
    """Return what is left of noise that is summed up, its model, and a prediction of each sample."""
    rng = np.random.default_rng(seed)
    parts = Parts(*map(np.array, ([1.0], [], [1.0], [1.0], [1.0, -1.0])), 0.0, np.zeros(0))
    noise = Noise(Contaminated(0.05, 20.0), 1.0, given=True)

    def predicts(level):
        return level - cleaned_residuals(parts, level, np.isfinite(level), noise).residual

    return np.cumsum(rng.normal(size=samples)), predicts


@pytest.mark.parametrize("seed", range(5))
def test_a_level_that_stays_where_it_jumped_is_believed_when_three_readings_agree(seed):
    level, predicts = _summed_up(seed)
    level[200:] += 20.0
    error = np.abs(level - predicts(level))
    # The prediction that follows the third reading is as good as any; one reading alone moves none.
    assert (error[200:203] > 12.0).all() and error[203:].max() < 6.0


@pytest.mark.parametrize("wild", [[20.0], [20.0, 20.0], [20.0, -13.0, 45.0, 20.0]])
def test_outliers_that_do_not_agree_for_long_move_no_prediction(wild):
    level, predicts = _summed_up(1)
    before = predicts(level)[200 : 210 + len(wild)]
    level[200 : 200 + len(wild)] += wild
    moved = np.abs(predicts(level)[200 : 210 + len(wild)] - before)
    assert moved.max() < 6.0 and moved[len(wild) + 3 :].max() < 0.1


def test_outliers_that_hide_each_other_are_found_all_at_once():
    a = np.real(np.poly([0.85 * np.exp(0.6j), 0.85 * np.exp(-0.6j), 0.8 * np.exp(1.6j), 0.8 * np.exp(-1.6j)]))
    mistakes = 0
    for seed in range(20, 24):
        rng = np.random.default_rng(seed)
        u, e, bad = rng.normal(size=1500), 0.1 * rng.normal(size=1500), rng.random(1500) < 0.1
        y = lfilter([0.0, 1.0, 0.5], a, u) + lfilter([1.0], a, e) + np.where(bad, 2.0, 0.0) * rng.normal(size=1500)
        model = PolynomialModel(ARX(4, 2), y / y.std(), u[:, None] / y.std(), False)
        found = found_outliers(model, np.append(a[1:], [1.0, 0.5]), np.zeros(1500, bool), Noise(START, 1e-4))
        mistakes += int((found.wrong != bad).sum() + (~found.counts).sum())
    # One after the other 222 are mistaken, of some 630 outliers.
    assert mistakes < 180


def test_outliers_of_one_size_are_not_taken_for_the_noise():
    a, missed, outliers = np.array([1.0, -1.5, 0.7]), 0, 0
    for seed in range(30, 36):
        rng = np.random.default_rng(seed)
        u, bad = rng.choice([-1.0, 1.0], 1000), rng.random(1000) < 0.3
        y = lfilter([0.0, 1.0, 0.5], a, u) + lfilter([1.0], a, 0.5 * rng.normal(size=1000))
        y[bad] += rng.choice([-2.0, 2.0], int(bad.sum()))
        model = PolynomialModel(ARX(2, 2), y / y.std(), u[:, None] / y.std(), False)
        found = found_outliers(model, np.append(a[1:], [1.0, 0.5]), np.zeros(1000, bool), Noise(START, 1.0))
        missed += int((bad & ~found.wrong).sum())
        outliers += int(bad.sum())
    # Looked for from the noise that the residuals seem to have 96 % are missed.
    assert missed < 0.6 * outliers, (missed, outliers)
