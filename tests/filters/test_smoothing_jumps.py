"""rts_smoother after a filter that doubts the process smooths with the process noise that the filter found."""

import numpy as np
import pytest
import support
from filterpy.common import Saver
from filterpy.kalman import KalmanFilter
from support import noise_given, two_sided

from robust_filterpy import Contaminated

LEVEL = support.with_(support.cart(), F=np.eye(2), Q=np.diag([0.01, 0.0]))
STEPS, JUMP = 60, 30


def recording():
    return np.where(np.arange(STEPS) < JUMP, 0.0, 12.0) + np.random.default_rng(0).normal(size=STEPS)


def doubting(kind):
    if kind is noise_given:
        noise = Contaminated(0.05, 100.0)
        return support.make(kind, LEVEL, noise=Contaminated(0.0), process=noise)
    return support.make(kind, LEVEL, noise=Contaminated(0.1, 5.0))


KINDS = [noise_given, two_sided]


@pytest.mark.parametrize("kind", KINDS)
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


@pytest.mark.parametrize("kind", KINDS)
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
