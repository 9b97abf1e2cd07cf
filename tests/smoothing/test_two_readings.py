"""A burst that can be followed is not, if it is less probable; a Q or R that does not fit is said, and only then."""

import warnings
from contextlib import nullcontext

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from support import of_matrices, without_kernel

from robust_filterpy import Huber, smooth
from robust_filterpy.influence import Linear
from robust_filterpy.smoothing.sweeps import _rows

G = np.array([0.5, 1.0])
PLANE = np.kron(np.eye(2), [[1.0, 1.0], [0.0, 1.0]])
POSITIONS = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])


def plane(q=0.05):
    return of_matrices(KalmanFilter, PLANE, POSITIONS, q**2 * np.kron(np.eye(2), np.outer(G, G)), P=1e4)


def walk(seed, steps=300, q=0.05):
    """Positions in the plane, shape (steps, 2), and what is measured of them."""
    rng = np.random.default_rng(seed)
    x, truth = np.array([0.0, 1.0, 0.0, 0.5]), np.empty((steps, 2))
    for k in range(steps):
        x = PLANE @ x + q * np.kron(np.eye(2), G[:, None]) @ rng.normal(size=2)
        truth[k] = POSITIONS @ x
    return truth, truth + rng.normal(size=truth.shape)


@pytest.mark.pairwise
@pytest.mark.parametrize("grouping", ["component", "joint"])
@pytest.mark.parametrize("q", [0.05, 0.1])
@pytest.mark.parametrize("length, off", [(20, 20.0), (50, 20.0), (50, 70.0), (50, 300.0)])
def test_a_burst_after_ten_good_samples_is_not_followed(length, off, q, grouping):
    for seed in range(40, 44):
        truth, zs = walk(seed, q=q)
        zs[10 : 10 + length] += off
        with (
            pytest.warns(UserWarning, match=f"samples 10 to {9 + length} are left out")
            if length == 50
            else nullcontext()
        ):
            found = smooth(plane(q), zs, grouping=grouping)
        assert (found.weights[10 : 10 + length] < 0.5).all()
        error = found.x[:, [0, 2], 0] - truth
        sd = np.sqrt(found.P[:, [0, 2], [0, 2]])
        assert np.abs(error / sd).max() < 6.0


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("gap", [100, 400])
@pytest.mark.parametrize("P0", [1e4, 1e6, 1e8])
def test_a_sensor_that_starts_late_is_smoothed_from_where_it_starts(P0, gap, monkeypatch):
    """What is known then is next to nothing: variances of residuals were differences of large numbers, and negative."""
    for seed in range(3):
        truth, zs = walk(seed, 600)
        rng = np.random.default_rng(seed)
        zs += np.where(rng.random(zs.shape) < 0.1, 50.0 * rng.normal(size=zs.shape), 0.0)
        zs[:gap] = np.nan
        kf = plane()
        kf.P = P0 * np.eye(4)
        late = smooth(kf, zs)
        error = (late.x[gap:, [0, 2], 0] - truth[gap:]) / np.sqrt(late.P[gap:, [0, 2], [0, 2]])
        assert np.abs(error).max() < 6.0
        if seed == 0 and gap == 100:
            without_kernel(monkeypatch)
            by_definition = smooth(kf, zs)
            monkeypatch.undo()
            np.testing.assert_allclose(by_definition.x[gap:], late.x[gap:], rtol=1e-4, atol=1e-4)


def test_inputs_and_gaps_are_part_of_what_is_probable():
    truth, zs = walk(52)
    pushed = np.zeros((300, 4))
    pushed[0, 1] = 5.0
    kf = plane()
    kf.B = np.eye(4)
    zs = zs + 5.0 * np.arange(1, 301)[:, None] * [1.0, 0.0]
    zs[10:60] += 70.0
    zs[200:210] = np.nan
    found = smooth(kf, zs, us=[PLANE @ u for u in pushed])
    there = found.x[:, [0, 2], 0] - truth - 5.0 * np.arange(1, 301)[:, None] * [1.0, 0.0]
    assert np.abs(there).max() < 8.0


def said(kf, zs, **options):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = smooth(kf, zs, **options)
    messages = [str(each.message) for each in caught]
    assert all(message.split(": ", 1)[1].split("; fit")[0] in found.message for message in messages)
    return " ".join(messages)


def level(q, r):
    return of_matrices(KalmanFilter, 1.0, [[1.0]], q, r, 100.0)


def moving(q, r):
    return of_matrices(KalmanFilter, [[1.0, 1.0], [0.0, 1.0]], [[1.0, 0.0]], q * 0.01 * np.outer(G, G), r, 10.0)


def wandering(kind, seed, contamination, steps=400):
    """Readings of a level, or of a point whose speed wanders."""
    rng = np.random.default_rng(seed)
    outlier, w = np.where(rng.random(steps) < contamination, 10.0, 1.0), rng.normal(size=steps)
    return (np.cumsum(w) if kind is level else np.cumsum(np.cumsum(0.1 * w))) + outlier * rng.normal(size=steps)


# What is filtered, the share of outliers, how wrong Q and R are, the words, and by which psi besides what is learnt.
@pytest.mark.parametrize("kind, share, q, r, words, psis", [
    (level, 0.0, 1.0, 1.0, (), [Huber()]), (level, 0.1, 1.0, 1.0, (), [Huber()]), (level, 0.3, 1.0, 1.0, (), []),
    (level, 0.0, 0.1, 1.0, ("process noise", "process=None"), [Linear()]),
    (level, 0.0, 1.0, 10.0, ("as R says",), [Linear()]), (level, 0.0, 10.0, 1.0, ("Q and R do not fit",), [Linear()]),
    # Of a smooth state it is also said of an R too small and a Q too large.
    *((moving, share, *row, []) for share in (0.0, 0.3) for row in (
        (1.0, 1.0, ()), (1.0, 0.1, ("look like outliers to R",)), (10.0, 1.0, ("as Q says",)),
    )),
])  # fmt: skip
def test_a_noise_that_does_not_fit_is_said_and_only_then(kind, share, q, r, words, psis):
    for seed in range(60, 64 if words or kind is moving else 75):
        zs = wandering(kind, seed, share, 400 if kind is level else 600)
        for influence in (None, *psis):
            found = said(kind(q, r), zs, influence=influence)
            assert all(word in found for word in words) and bool(words) == bool(found), (seed, influence, found)
    assert kind is moving or not said(level(10.0, 10.0), zs[:12]), "few samples say nothing"


@pytest.mark.parametrize("begin, end", [(150, 300), (0, 60), (200, 300)])
def test_a_state_that_has_moved_is_followed(begin, end):
    """What lasts to an end of the recording is no burst, though one offset would explain it as well."""
    for seed in range(3):
        truth, zs = walk(seed)
        truth[begin:end] += 10.0
        zs[begin:end] += 10.0
        error = smooth(plane(), zs).x[:, [0, 2], 0] - truth
        assert np.sqrt(np.mean(error**2)) < 1.2


def test_a_row_of_outliers_is_one_that_chance_hardly_makes():
    """Of 300 samples with three outliers in ten, gaps of one allowed, one such row in a hundred recordings."""
    rng = np.random.default_rng(0)
    rows = sum(len(_rows(rng.random(300) < 0.3)) for _ in range(400))
    assert rows < 4.0 + 5.0 * 4.0**0.5
    outliers = np.arange(300) % 3 == 0
    outliers[100:120] = True
    (row,) = _rows(outliers)
    assert row[0] <= 100 and row[1] >= 120
