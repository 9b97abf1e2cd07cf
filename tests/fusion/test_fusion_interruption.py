"""Ctrl-C anywhere in a fusion: the reading was taken or it was not, and what comes afterwards is as if it never was."""

import copy

import numpy as np
import pytest
from fusion.worlds import fed
from interruption import interrupted

from robust_filterpy import Huber
from robust_filterpy.fusion import Fusion, Sensor, constant_velocity


def fused(**options):
    sensors = {"fast": Sensor([1.0, 0.0], 0.3), "slow": Sensor([1.0, 0.0], 0.3, delay=0.5)}
    return Fusion(constant_velocity(1, q=0.1), sensors, window=2.0, **options)


def readings(count):
    rng = np.random.default_rng(2)
    for k in range(count):
        z = 0.25 * k + rng.normal() + 50.0 * (k % 11 == 8)
        yield "slow" if k % 3 == 2 else "fast", 0.25 * k - 1.01 * (k % 5 == 4), z


def estimated(one):
    found = one.estimate()
    return np.concatenate([found.x, found.P.ravel()])


@pytest.mark.parametrize("options", [{}, {"influence": Huber()}], ids=["learned", "huber"])
@pytest.mark.parametrize("count, every", [(21, 1), (633, 11)], ids=["late", "let go"])
def test_a_fusion_that_was_interrupted_goes_on_as_if_it_had_not_been(options, count, every):
    *first, one, other = readings(count)
    ready = fused(**options)
    fed(ready, first)
    estimated(ready)
    done = copy.deepcopy(ready)
    fed(done, (one, other))
    expected, outcomes = estimated(done), set()
    for at in range(1, 30_000, every):
        broken = copy.deepcopy(ready)
        if not interrupted(lambda broken=broken: broken.observe(*one), at, calls=True):
            break
        outcomes.add(broken.observe(*one))
        broken.observe(*other)
        np.testing.assert_array_equal(estimated(broken), expected, err_msg=f"interrupted at {at}")
    assert at > 20 and len(outcomes) == 2 and "duplicate" in outcomes
