"""Unknown outputs among neighbors, predictions through outliers: the numbers of the plain algebra."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from robust_filterpy import ARX, Contaminated, identify
from robust_filterpy.correction.contaminated import START
from robust_filterpy.identification.estimation.outliers import Chain, begun
from robust_filterpy.identification.estimation.prediction_error import Limits
from robust_filterpy.identification.models.model import cleaned_residuals
from robust_filterpy.identification.models.noise import Noise
from robust_filterpy.identification.models.polynomial_model import Parts, PolynomialModel


def _chain(structure, p, y, u, missing):
    """Return what draws outliers for given parameters."""
    model = PolynomialModel(structure, y / y.std(), u[:, None] / y.std(), False)
    return Chain(model, begun(model, p, Noise(START, 1.0), missing, ""), missing, np.arange(0), None)


@pytest.mark.parametrize(("order", "share", "gap"), [(2, 0.1, 0), (2, 0.4, 30), (6, 0.1, 12)])
def test_unknown_samples_are_those_of_the_plain_algebra(order, share, gap):
    rng, samples = np.random.default_rng(1), 300
    y, a = rng.normal(size=samples), rng.normal(size=order) * 0.5 ** np.arange(order)
    missing = rng.random(samples) < share
    missing[40 : 40 + gap] = True
    chain = _chain(ARX(order, 1), np.append(a, 1.0), y, rng.normal(size=samples), missing)
    chain.wide, chain.of_v = rng.random(samples - order) < 0.2, chain.of_v._replace(variance=9.0)
    chain.wrong |= rng.random(samples) < 0.1
    X = np.array([lfilter([1.0, *a], [1.0], one)[order:] for one in np.eye(samples)[chain.wrong]]).T
    prior = np.where(missing[chain.wrong], 0.0, 1.0 / chain.of_y.variance)
    base = chain.completed().residuals(chain.p)
    covariance = np.linalg.pinv(X.T @ (X * chain.precision[:, None]) + np.diag(prior))
    mean, residual = -covariance @ X.T @ (chain.precision * base), base.copy()
    chain.redraw_sizes(residual)
    np.testing.assert_allclose(chain.correction[chain.wrong], mean, atol=1e-6 * np.abs(mean).max())
    np.testing.assert_allclose(residual, base + X @ mean, atol=1e-6)
    np.testing.assert_allclose(chain.completed().residuals(chain.p), residual, atol=1e-9)
    drawn = []
    for _ in range(500):
        chain.redraw_sizes(residual, chain.rng)
        drawn.append((chain.correction[chain.wrong] - mean) / np.sqrt(covariance.diagonal()))
    # Of draws that know nothing of each other.
    assert np.abs(np.mean(drawn, axis=0)).max() < 5.0 / np.sqrt(500)
    assert np.abs(np.mean(np.square(drawn), axis=0) - 1.0).max() < 5.0 * np.sqrt(2.0 / 500)


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


def test_a_draw_beyond_a_limit_is_refused():
    # A draw that were moved to the limit would stand there, with the likelihood of where it was.
    rng = np.random.default_rng(4)
    u, wild = rng.normal(size=600), np.where(rng.random(600) < 0.1, 5.0, 0.0) * rng.normal(size=600)
    y, missing = lfilter([0.0, 1.0], [1.0, -0.9], u) + lfilter([1.0], [1.0, -0.9], rng.normal(size=600)), wild > 9.0
    y += wild
    model, infinite = PolynomialModel(ARX(1, 1), y, u[:, None], False), np.array([np.inf, np.inf])
    limits = Limits(np.array([-0.9, -np.inf]), infinite)
    start = begun(model, np.array([-0.89, 1.0]), Noise(START, 1.0), missing, "")
    chain = Chain(model, start, missing, np.arange(2), limits)
    drawn = []
    for _ in range(200):
        chain._turn(False)
        drawn.append(chain.p[0])
    assert min(drawn) > -0.9 and np.ptp(drawn) > 0.005
    model = identify(y, u, ARX(1, 1), bounds={"a1": (-0.8, None)}, offset=False, progress=False)
    assert model.theta[0] == -0.8 and model.std[0] == 0.0 and "a1 ended at a bound" in model.warning


def _mistaken(a, b, u, e, wild):
    """Return how many samples of an ARX are mistaken for outliers, or missed, by most of the draws."""
    y = lfilter(b, a, u) + lfilter([1.0], a, e) + wild
    chain = _chain(ARX(len(a) - 1, 2), np.append(a[1:], b[1:]), y, u, np.zeros(y.size, dtype=bool))
    chain.settled(chain.p, chain.draws(50, afresh=True))
    return int((chain.wrong != (wild != 0.0)).sum() + chain.wide.sum())


def test_outliers_that_hide_each_other_are_seen_all_at_once():
    a = np.real(np.poly([0.85 * np.exp(0.6j), 0.85 * np.exp(-0.6j), 0.8 * np.exp(1.6j), 0.8 * np.exp(-1.6j)]))
    mistakes = 0
    for seed in range(20, 24):
        rng = np.random.default_rng(seed)
        u, e, bad = rng.normal(size=1500), 0.1 * rng.normal(size=1500), rng.random(1500) < 0.1
        mistakes += _mistaken(a, [0.0, 1.0, 0.5], u, e, np.where(bad, 2.0, 0.0) * rng.normal(size=1500))
    # One after the other 222 are mistaken, of some 630 outliers, and 115 here.
    assert mistakes < 160


def test_outliers_of_one_size_are_not_taken_for_the_noise():
    a, mistakes = np.array([1.0, -1.5, 0.7]), 0
    for seed in range(30, 36):
        rng = np.random.default_rng(seed)
        u, bad = rng.choice([-1.0, 1.0], 1000), rng.random(1000) < 0.3
        e, wild = 0.5 * rng.normal(size=1000), np.where(bad, rng.choice([-2.0, 2.0], 1000), 0.0)
        mistakes += _mistaken(a, [0.0, 1.0, 0.5], u, e, wild)
    # Looked for from the noise that the residuals seem to have, 96 % of 1744 are missed.
    assert mistakes < 800


def test_outliers_of_the_process_are_not_those_of_the_sensor():
    a, mistakes = np.array([1.0, -1.5, 0.7]), 0
    for seed in range(3):
        rng = np.random.default_rng(seed)
        u, bad = rng.choice([-1.0, 1.0], 1000), rng.random(1000) < 0.1
        e = np.where(bad, 5.0, 0.5) * rng.normal(size=1000)
        y = lfilter([0.0, 1.0, 0.5], a, u) + lfilter([1.0], a, e)
        chain = _chain(ARX(2, 2), np.array([*a[1:], 1.0, 0.5]), y, u, np.zeros(1000, dtype=bool))
        chain.settled(chain.p, chain.draws(50, afresh=True))
        mistakes += int(chain.wrong.sum() + (chain.wide != bad[2:]).sum())
    # Of 272 outliers, of which a quarter are as small as ordinary ones.
    assert mistakes < 110
