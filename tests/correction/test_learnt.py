"""Learnt noise as pure functions: the step is Bayes' rule on small mixtures, the counts are those of a Markov chain."""

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.linalg import solve_discrete_lyapunov
from scipy.stats import multivariate_normal, norm
from support import random_problem, spd

from robust_filterpy.correction import side_by_side
from robust_filterpy.correction.learning import (
    NoiseClasses,
    describe,
    learn,
    left_over,
    ordinary_size,
    parity,
    start,
    together,
    weigh_together,
)
from robust_filterpy.correction.learnt import _inverted, correct
from robust_filterpy.correction.side_by_side import Scales
from robust_filterpy.correction.spread import NUMBERS

TRUSTED = Scales((1.0,), jump=0.0)


def one(x, P):
    return side_by_side.start(np.asarray(x, dtype=float), np.asarray(P, dtype=float), TRUSTED)


def certain(K, last=0):
    """What is known before a sample if the last one's class was certain."""
    known = start(K)
    known[2 + K : 2 + 2 * K] = np.eye(K)[last]
    return known


@pytest.mark.parametrize("y", [0.0, 0.7, 2.0, 4.0, 8.0])
def test_one_sensor_under_a_given_mixture_has_the_moments_of_the_posterior(y):
    """Mean, variance and density by quadrature, and the mean square of the noise of class 0, from which r is learnt."""
    P, R, scales, shares = 0.7, 0.5, (1.0, 100.0), (0.9, 0.1)

    def integral(power, *classes):
        """Of a power of the noise y - x over the joint density of x and y."""
        return sum(
            quad(lambda x, k=k: (y - x) ** power * shares[k] * norm(0.0, np.sqrt(P)).pdf(x)
                 * norm(x, np.sqrt(scales[k] * R)).pdf(y), -12, 12, points=[0, y], limit=300, epsabs=0.0)[0]
            for k in classes
        )  # fmt: skip

    def corrected(noise):
        memory = noise.start(1)
        return correct(one([0.0], [[P]]), memory, np.array([y]), np.eye(1), R * np.eye(1), noise, TRUSTED), memory

    mass, first, second = (integral(power, 0, 1) for power in range(3))
    found, memory = corrected(NoiseClasses(scales=scales, probabilities=shares))
    assert y - found.models.x.item() == pytest.approx(first / mass, rel=1e-7, abs=1e-10)
    assert found.models.P.item() == pytest.approx(second / mass - (first / mass) ** 2, rel=1e-7)
    assert found.log_density == pytest.approx(np.log(mass), rel=1e-7)
    np.testing.assert_array_equal(found.memory, memory)
    found, _ = corrected(NoiseClasses(scales=(1.0,)))
    expected = 1.0 + (integral(2, 0) / integral(0, 0) / R - 1.0) / found.memory[0, 1]
    assert found.memory[0, 0] == pytest.approx(expected, rel=1e-8)


def test_sensors_with_correlated_noise_tell_of_each_other():
    """One class each, whose size has been learnt: the Kalman filter with the full R and M, scaled."""
    rng = np.random.default_rng(3)
    problem, noise = random_problem(3, 4, 3), NoiseClasses(scales=[1.0])
    x, P, H, z, memory = problem.x[:, 0], problem.P, problem.H, rng.standard_normal(3), noise.start(3)
    memory[:, 0] = r = np.array([4.0, 0.3, 1.7])
    R, M = np.sqrt(np.outer(r, r)) * problem.R, 0.5 * np.sqrt(r) * problem.M
    found = correct(one(x, P), memory, z, H, problem.R, noise, TRUSTED, 0.5 * problem.M)
    S, C, y = H @ P @ H.T + R + H @ M + (H @ M).T, P @ H.T + M, z - H @ x
    assert_allclose(found.models.x[0], x + C @ np.linalg.solve(S, y), rtol=1e-8)
    assert_allclose(found.models.P[0], P - C @ np.linalg.solve(S, C.T), rtol=1e-7, atol=1e-10)
    assert found.log_density == pytest.approx(multivariate_normal.logpdf(y, cov=S))


def test_the_excess_of_an_outlier_is_independent_of_everything_else():
    """Two sensors whose ordinary noises are correlated, the first of them all but surely an outlier."""
    rng = np.random.default_rng(1)
    P, R, H, y = spd(rng, 3), np.array([[1.0, 0.7], [0.7, 2.0]]), rng.normal(size=(2, 3)), np.array([25.0, 0.3])
    noise = NoiseClasses(scales=(1.0, 100.0), probabilities=(0.9, 0.1))
    found = correct(one(np.zeros(3), P), noise.start(2), y, H, R, noise, TRUSTED)
    S = H @ P @ H.T + R + np.diag([99.0, 0.0])
    assert_allclose(found.outlier_probabilities, [1.0, 0.0], atol=0.1)
    sure = NoiseClasses(scales=(1.0, 1.0 + 1e-12), probabilities=(0.5, 0.5))
    exact = correct(one(np.zeros(3), P), sure.start(2), y, H, R + np.diag([99.0, 0.0]), sure, TRUSTED)
    assert_allclose(exact.models.x[0], P @ H.T @ np.linalg.solve(S, y), rtol=1e-8)
    assert_allclose(found.models.x[0], exact.models.x[0], rtol=0.15, atol=0.05)


def test_transitions_are_counted_with_a_memory():
    """Classes that are certain: counts = prior + sum of forgotten ones."""
    K, memory, rng = 3, 20.0, np.random.default_rng(2)
    noise = NoiseClasses(scales=(1.0, 10.0, 100.0), memory=memory)
    labels = np.concatenate([[0], rng.choice(K, 60, p=[0.8, 0.1, 0.1])])
    known, counts = certain(K), np.zeros((K, K))
    for before, now in itertools.pairwise(labels):
        known = learn(known, np.eye(K)[now], 1.0, 0.0, 1.0, noise)
        counts *= 1.0 - 1.0 / memory
        counts[before, now] += 1.0
    places = slice(2 + 2 * K, 2 + 2 * K + K * K)
    assert_allclose(known[places], start(K)[places] + counts.ravel(), rtol=1e-10)


def test_a_sample_counts_by_the_square_of_the_part_that_is_noise_and_one_is_never_forgotten():
    """n = 1 + sum of forgotten k^2: r is learnt from what tells of it, however little."""
    noise, ordinary, counts = NoiseClasses(r_memory=50.0), np.eye(4)[0], {}
    for part in (1.0, 0.2, 1e-9):
        known = start(4)
        for _ in range(2000):
            known = learn(known, ordinary, known[0], 0.0, part, noise)
        counts[part] = known[1]
    assert counts == pytest.approx({1.0: 51.0, 0.2: 3.0, 1e-9: 1.0})
    # E[v^2] of an innovation that is all noise, nine times as large.
    assert learn(start(4), ordinary, 1.0, 8.0, 1.0, noise)[0] == pytest.approx(1.0 + 8.0 / (1.0 + 0.98 * 19.0 + 1.0))


def test_when_ordinary_samples_are_few_r_starts_from_the_class_of_the_median():
    known, begin = start(4), start(4)
    known[0] = 0.3
    for _ in range(200):
        known = learn(known, np.array([0.05, 0.15, 0.75, 0.05]), 1.0, 0.0, 1.0, NoiseClasses())
        if known[0] > 10.0:
            break
    # Class 2 had 100 times the variance; everything else is as before the first sample.
    assert 10.0 < known[0] < 100.0
    assert_allclose(known[1:-17], begin[1:-17])


def test_describe_reads_a_chain_that_is_known():
    """Outliers a tenth of the time, in runs of five, of class 2."""
    counts = np.zeros((4, 4))
    counts[2, 2], counts[2, 0], counts[0, 2], counts[0, 0] = 80.0, 20.0, 20.0, 880.0
    scales = np.array([1.0, 10.0, 100.0, 1000.0])
    learnt = np.concatenate([[4.0, 16.0], np.zeros(8), counts.ravel(), np.zeros(16 + NUMBERS)])[None]
    noise = describe(learnt, scales)
    assert noise.contamination[0] == pytest.approx(0.1) and noise.run_length[0] == pytest.approx(5.0)
    assert noise.scale_ratio[0] == pytest.approx(10.0, rel=0.01)
    assert noise.r[0] == 4.0 and noise.r_std[0] == pytest.approx(1.0)
    # The variance of a share of correlated samples: (1 + rho)/(1 - rho) times the independent ones'.
    rho = 0.8 - 20.0 / 900.0
    assert noise.contamination_std[0] == pytest.approx(np.sqrt(0.09 / 1001 * (1 + rho) / (1 - rho)))
    assert describe(learnt, scales, sensors=4).r_std[0] == pytest.approx(0.5)


@pytest.mark.parametrize("grouping", ["component", "joint"])
def test_r_does_not_depend_on_how_wild_an_outlier_is(grouping):
    """Of classes so narrow that no outlier is surely one; a jump would have a size."""
    noise, process = NoiseClasses(scales=(1.0, 1.1), grouping=grouping), Scales(jump=0.0)
    P, H, R = spd(np.random.default_rng(6), 3), np.random.default_rng(7).normal(size=(2, 3)), np.diag([1.0, 2.0])
    memory, learned = noise.start(1 if grouping == "joint" else 2), []
    for wild in (1e9, 1e12, 1e290):
        models = side_by_side.start(np.zeros(3), P, process)
        y = np.array([wild if grouping == "joint" else 0.3, wild])
        found = correct(models, memory, y, H, R, noise, process)
        # All but the reading itself, and what the recursion as given takes it for.
        learned.append(np.delete(found.memory, np.r_[-17 - NUMBERS : -17, -2:0], axis=1))
    for other in learned[1:]:
        assert_allclose(other, learned[0], rtol=1e-6)


def test_parity_does_not_depend_on_the_state_and_has_the_variance_that_R_gives_it():
    rng = np.random.default_rng(5)
    H, r = rng.normal(size=(4, 2)), np.array([1.0, 4.0, 0.3, 2.0])
    R = np.diag([1.0, 2.0, 3.0, 0.5])
    zs = rng.normal(size=(4000, 4)) * np.sqrt(R.diagonal())
    found = np.array([[e for _, e, _ in parity(z, H, R, r)] for z in zs])
    assert_allclose(found.var(axis=0), 1.0, atol=5.0 * np.sqrt(2.0 / 4000))
    moved = parity(zs[0] + H @ np.array([30.0, -7.0]), H, R, r)
    assert_allclose([e for _, e, _ in moved], found[0], atol=1e-10)
    # Nobody can stand in for a sensor that alone sees a state.
    assert [i for i, *_ in parity(zs[0, :3], np.array([[1.0, 0], [1.0, 0], [0, 1.0]]), R[:3, :3], r[:3])] == [0, 1]
    assert parity(zs[0, :2], H[:2], R[:2, :2], r[:2]) == []


@pytest.mark.parametrize("phi, floor", [(0.0, 1e-3), (0.95, 0.3)])
def test_r_of_a_sensor_that_others_contradict_with_a_colour_does_not_fall(phi, floor):
    rng, v, learnt = np.random.default_rng(6), np.zeros(2), np.tile(start(4), (2, 1))
    learnt[:, 0] = 1e-4
    for _ in range(400):
        v = phi * v + np.sqrt(1.0 - phi * phi) * rng.normal(size=2)
        r, learnt = ordinary_size(learnt, v, v, v, np.zeros((2, 2)), np.ones((2, 1)), np.eye(2))
    assert (r > floor).all() == (phi > 0.0)


@pytest.mark.parametrize("lag", [0.5, 0.9])
def test_coloured_noise_is_weighed_as_white_noise_that_leaves_a_filter_as_uncertain(lag):
    """e(k) = q e(k-1) + (1 - q) v(k), v coloured: its variance, by the Lyapunov equation, over that of white noise."""
    seen = np.full((2, 2), 0.5)
    learnt = np.tile(start(4), (2, 1))
    learnt[:, -10:-6] = 0.0, lag, 1.0, 1e9
    r, _ = ordinary_size(learnt, np.zeros(2), np.zeros(2), np.zeros(2), seen, np.ones((2, 1)), np.eye(2))
    # Two readings of variance 1 leave a half of a variance of .5.
    q, left = 0.5, []
    for c in (lag, 0.0):
        into = np.array([[1.0 - q], [1.0]])
        moves = np.array([[q, (1.0 - q) * c], [0.0, c]])
        left.append(solve_discrete_lyapunov(moves, (1.0 - c * c) * into @ into.T)[0, 0])
    assert_allclose(r, left[0] / left[1], rtol=1e-9)


def test_whether_sensors_fail_together_is_learnt_and_then_they_are_judged_together():
    rng, F, H, R = np.random.default_rng(3), np.eye(1), np.ones((3, 1)), np.eye(3)
    for alike, expected in ((True, 1.0), (False, 0.0)):
        models, memory = side_by_side.start(np.zeros(1), np.eye(1), TRUSTED), NoiseClasses().start(3)
        for _ in range(300):
            sizes = np.where(rng.random(1 if alike else 3) < 0.1, 10.0, 1.0)
            models = side_by_side.predict(models, F, 1e-2 * F, TRUSTED)
            found = correct(models, memory, sizes * rng.normal(size=3), H, R, NoiseClasses(), TRUSTED)
            models, memory = found.models, found.memory
        assert together(memory) == pytest.approx(expected, abs=0.05)
        # Readings that are ordinary one by one, and impossible if they are so together.
        z = np.array([1.5, 0.2, -9.0])
        models = side_by_side.predict(models, F, 1e-2 * F, TRUSTED)
        outlying = correct(models, memory, z, H, R, NoiseClasses(), TRUSTED).outlier_probabilities
        named = correct(models, memory, z, H, R, NoiseClasses(grouping=((0, 1, 2),)), TRUSTED).outlier_probabilities
        assert named.min() > 0.9 and outlying[2] > 0.9
        assert (np.abs(outlying - named) < 0.1).all() if alike else (outlying[:2] < 0.1).all()


def test_evidence_of_failing_together_is_worth_a_hundred_to_one_at_most_and_is_forgotten():
    learnt, noise = np.tile(start(4), (2, 1)), NoiseClasses()
    after = weigh_together(learnt, 1e9, 0.0, noise)
    assert together(after) == pytest.approx(100.0 / 199.0)
    assert together(weigh_together(learnt, -1e9, 0.0, noise)) == pytest.approx(0.01 / 99.01)
    for _ in range(3000):
        after = weigh_together(after, 0.0, 0.0, noise)
    assert together(after) == pytest.approx(0.01, abs=1e-4)


@pytest.mark.parametrize("slope, most", [(0.0, 16.0), (5.0, 16.0)])
def test_r_is_not_far_above_what_changes_show(slope, most):
    """White noise of variance 1 on a reading that drifts away from what is predicted, which is 0 for ever."""
    rng, learnt = np.random.default_rng(2), start(4)[None]
    for k in range(200):
        y = np.array([slope * k + rng.normal()])
        learnt[0, 0] = 1e6
        r, learnt = ordinary_size(learnt, y, y, y, np.zeros((1, 1)), np.eye(1), np.eye(1))
        learnt = left_over(learnt, y, np.eye(1))
        assert k > 20 or r == 1e6
    assert 1.0 <= r[0] < most and learnt[0, 0] == r[0]


def following(zs, jump=1e-9):
    """The state of a random walk's filter after each sample."""
    noise, process = NoiseClasses(), Scales(jump=jump)
    models, memory, path = side_by_side.start(np.zeros(1), np.eye(1), process), noise.start(1), []
    for z in zs:
        models = side_by_side.predict(models, np.eye(1), 0.01 * np.eye(1), process)
        found = correct(models, memory, np.array([z]), np.eye(1), np.eye(1), noise, process)
        models, memory = found.models, found.memory
        path.append(side_by_side.merged(models, process)[0].item())
    return np.array(path)


def test_a_sensor_that_repeats_itself_far_off_is_stuck_and_says_nothing():
    zs = np.random.default_rng(1).normal(size=180)
    zs[140:170] = 50.0
    assert np.abs(following(zs)).max() < 5.0
    coarse = np.where(zs == 50.0, zs, np.round(zs, 1))
    assert np.abs(following(coarse)).max() < 5.0
    # Near the state it is believed; what is wild, repeats itself as usual or is without noise may jump.
    zs[110:170] = 0.5
    assert np.abs(following(zs)[168:170] - 0.5).max() < 0.1
    zs[140:170] = 50.0 + 1e-9 * np.arange(30)
    others = {"wild": zs.copy()}
    zs[140:170] = 50.0
    others |= {"steps": np.round(zs), "twice": np.repeat(zs[::2], 2)}
    others["no noise"] = np.where(zs == 50.0, zs, np.sin(np.arange(180) / 20.0))
    for name, values in others.items():
        assert np.abs(following(values)[160:170] - 50.0).max() < 1.0, name


def test_where_no_cholesky_factor_is_found_whitening_gives_the_same_inverses_of_one_and_of_many(monkeypatch):
    rng = np.random.default_rng(0)
    S = np.array([[spd(rng, 3) * np.outer(unit, unit) for unit in ([1.0, 5.0, 0.1], [2.0, 1.0, 30.0])] for _ in "ab"])
    expected = [_inverted(a) for a in (S, S[0], S[0, 0])]

    def fails(_):
        raise np.linalg.LinAlgError

    monkeypatch.setattr(np.linalg, "cholesky", fails)
    for a, (inverses, log_dets) in zip((S, S[0], S[0, 0]), expected, strict=True):
        found = _inverted(a)
        assert_allclose(found[0] @ a, np.broadcast_to(np.eye(3), a.shape), atol=1e-9)
        assert_allclose(found[0], inverses, rtol=1e-9, atol=1e-12)
        assert_allclose(found[1], log_dets, rtol=1e-9)
