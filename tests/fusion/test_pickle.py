"""A fusion, and what it is made of, goes to another process and comes back the same."""

import copy
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
    return np.array([[10.0 / (100.0 + x[0] ** 2), 0.0]])


def grown(dt):
    return np.eye(2) * dt


MOTIONS = {
    "velocity": constant_velocity(1, q=0.1),
    "acceleration": constant_acceleration(1, q=0.1),
    "continuous": from_continuous([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], 3.0, [[0.0], [1.0]]),
    "function": from_function(drag, drag_slope, 0.1 * np.eye(2), 2),
    "function with Q(dt)": from_function(drag, drag_slope, grown, 2),
}
OPTIONS = {
    "default": {}, "watch": {"watch": True}, "bounded": {"influence": Huber()}, "noise": {"noise": Learnt()},
    "reacquire": {"reacquire": Reacquisition()},
}  # fmt: skip


@pytest.mark.parametrize("name", MOTIONS)
def test_a_motion_comes_back_the_same(name):
    motion = MOTIONS[name]
    for other in (pickle.loads(pickle.dumps(motion)), copy.deepcopy(motion)):
        x, u = np.linspace(1.0, 2.0, motion.dim_x), np.ones(motion.dim_u)
        for dt in (0.0, 0.3, 0.3, 7.0):
            for a, b in zip(motion.over(dt, x, u), other.over(dt, x, u), strict=True):
                np.testing.assert_array_equal(a, b)
        assert other.names == motion.names and repr(other) == repr(motion)
        # The same stretch comes again and again.
        assert other.matrices(0.3) is other.matrices(0.3)


@pytest.mark.parametrize("options", OPTIONS)
def test_a_fusion_goes_on_the_same_after_pickle(options):
    sensors = {"gps": Sensor([1.0, 0.0], R=1.0), "bearing": Sensor(h=h, jacobian=slope, residual=angle, R=0.01)}
    fusion = Fusion(MOTIONS["velocity"], sensors, window=5.0, **OPTIONS[options])
    for t in range(20):
        fusion.observe("gps", float(t), 2.0 * t)
        fusion.observe("bearing", t + 0.5, 1.0)
    other = pickle.loads(pickle.dumps(fusion))
    for one in (fusion, other):
        one.observe("gps", 18.2, 36.0)
        one.observe("gps", 21.0, 42.0)
    np.testing.assert_array_equal(fusion.estimate().x, other.estimate().x)
    np.testing.assert_array_equal(fusion.estimate().P, other.estimate().P)
    assert fusion.counts == other.counts and repr(fusion) == repr(other)
