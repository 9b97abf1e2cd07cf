"""Many filters that go on together: a step at a time from the state that the last one returned."""

import numpy as np
import pytest
import support

from robust_filterpy import Huber, TukeyBiweight, filter_series

OPTIONS = {
    "default": {},
    "innovation": {"scaling": "innovation", "information": "expected"},
    "bounded": {"scaling": "bounded"},
    "joint": {"grouping": "joint", "influence": TukeyBiweight()},
    "learnt noise": {"noise": "learnt", "process": "scales"},
    "by the definition": {"influence": Huber(1.5), "grouping": ((0, 1),)},
}


@pytest.mark.parametrize("name", OPTIONS)
def test_a_step_at_a_time_gives_the_bits_of_one_call(name):
    rng = np.random.default_rng(7)
    F, H, Q = support.stable(rng, 3), 0.3 * rng.normal(size=(2, 3)), 0.01 * np.eye(3)
    R, P0 = np.array([support.spd(rng, 2) for _ in range(4)])[:, None], 0.1 * np.eye(3)
    zs = rng.normal(size=(4, 30, 2)) + 50.0 * (rng.random((4, 30, 2)) < 0.1)
    zs[rng.random(zs.shape) < 0.2] = np.nan
    options = OPTIONS[name]
    whole = filter_series(zs, F, H, Q, R, np.zeros(3), P0, **options)
    start = {"x0": np.zeros(3), "P0": P0}
    for k in range(zs.shape[1]):
        result = filter_series(zs[:, k : k + 1], F, H, Q, R, **start, **options)
        np.testing.assert_array_equal(result.x[:, 0], whole.x[:, k])
        np.testing.assert_array_equal(result.P[:, 0], whole.P[:, k])
        np.testing.assert_array_equal(result.weights[:, 0], whole.weights[:, k])
        start = {"state": result.state}
    for name, array in whole.state.items():
        np.testing.assert_array_equal(result.state[name], array)
