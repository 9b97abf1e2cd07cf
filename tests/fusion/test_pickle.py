"""A fusion, and what it is made of, goes to another process and comes back the same."""

import pickle

import numpy as np
import pytest

from robust_filterpy import Huber, Learnt
from robust_filterpy.fusion import (
    Fusion,
    Reacquisition,
    Sensor,
    angle,
    constant_acceleration,
    constant_velocity,
    from_continuous,
    from_function,
)


def drag(x, dt):
    return np.array([x[0] + dt * x[1], x[1] * (1.0 - 0.1 * dt)])


def drag_slope(x, dt):
    return np.array([[1.0, dt], [0.0, 1.0 - 0.1 * dt]])


def h(x):
    return np.arctan2(x[:1], 10.0)


def slope(x):
    return np.eye(1, len(x)) * 10.0 / (100.0 + x[0] ** 2)


def grown(dt):
    return np.eye(2) * dt


@pytest.mark.parametrize(("motion", "options"), [
    (constant_velocity(1, q=0.1), {}), (constant_acceleration(1, q=0.1), {"watch": True}),
    (from_continuous([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], 3.0, [[0.0], [1.0]]), {"influence": Huber()}),
    (from_function(drag, drag_slope, 0.1 * np.eye(2), 2), {"noise": Learnt()}),
    (from_function(drag, drag_slope, grown, 2), {"reacquire": Reacquisition()}),
], ids=["velocity", "acceleration", "continuous", "function", "function with Q(dt)"])  # fmt: skip
def test_a_fusion_goes_on_the_same_after_pickle(motion, options):
    place = {"H": np.eye(1, motion.dim_x), "R": 1.0}
    sensors = {"gps": Sensor(**place), "bearing": Sensor(h=h, jacobian=slope, residual=angle, R=0.01)}
    fusion = Fusion(motion, sensors, window=5.0, **options)
    for t in range(20):
        fusion.observe("gps", float(t), 2.0 * t)
        fusion.observe("bearing", t + 0.5, 1.0)
    other, copied = pickle.loads(pickle.dumps((fusion, motion)))
    for one in (fusion, other):
        one.observe("gps", 18.2, 36.0)
        one.observe("gps", 21.0, 42.0)
    assert all(np.array_equal(a, b) for a, b in zip(fusion.estimate()[:2], other.estimate()[:2], strict=True))
    assert fusion.counts == other.counts and repr(fusion) == repr(other)
    # The same stretch comes again and again.
    assert repr(copied) == repr(motion) and copied.matrices(0.3) is copied.matrices(0.3)
