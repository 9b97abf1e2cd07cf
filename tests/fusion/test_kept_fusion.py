"""What is kept of a fusion: a state that is stored, damaged or restored, and a pickle."""

import pickle
from pathlib import Path

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


def test_a_fusion_goes_on_from_a_stored_state():
    stored = dict(np.load(Path(__file__).with_name("stored_fusion.npz")))
    x, P = stored.pop("then_x"), stored.pop("then_P")
    sensors = {"gps": Sensor([1.0, 0.0], R=1.0), "speed": Sensor([0.0, 1.0])}
    options = {"P0": np.eye(2), "watch": True, "reacquire": Reacquisition()}
    fusion, other = (Fusion(constant_velocity(1, q=0.1), sensors, 4.0, **options) for _ in range(2))
    fusion.restore(stored)
    now = fusion.state()
    assert all(np.array_equal(now[name], part, equal_nan=True) for name, part in stored.items())
    other.restore(now)
    assert all(np.array_equal(now[name], part, equal_nan=True) for name, part in other.state().items())
    # 114 numbers say what is in doubt, after one that says whether something is.
    assert len(stored["moments"]) == 13 and stored["moments"][-1, -115] == 1.0
    fusion.observe("gps", 12.0, 24.0)
    fusion.observe("speed", 12.0, 2.0)
    estimate = fusion.estimate(13.0)
    np.testing.assert_allclose(estimate.x, x, rtol=1e-9)
    np.testing.assert_allclose(estimate.P, P, rtol=1e-9)


@pytest.mark.parametrize("options", [{}, {"watch": True}, {"reacquire": Reacquisition()}])
def test_a_fusion_whose_first_reading_is_of_its_start_goes_on_from_its_state(options):
    def made():
        return Fusion(constant_velocity(1), {"gps": Sensor([1.0, 0.0], R=1.0)}, 5.0, t0=0.0, **options)

    fusion, other = made(), made()
    for t in (0.0, 1.0):
        fusion.observe("gps", t, 2.0 * t)
    state = fusion.state()
    other.restore(state)
    assert other.estimate().x.tobytes() == fusion.estimate().x.tobytes() and other.counts == fusion.counts
    for keys in (state["keys"][::-1], state["keys"] - [1.0, 0.0]):
        with pytest.raises(ValueError, match="keys that ascend, after base"):
            made().restore({**state, "keys": keys})


def driven():
    fusion = Fusion(constant_velocity(1), {"a": Sensor([1.0, 0.0], R=1.0)}, 5.0)
    for t in ("2024-01-01", "2024-01-02", "2024-01-03"):
        fusion.observe("a", np.datetime64(t), 1.0)
        fusion.control(np.datetime64(t), [0.1])
    return fusion


def changed(state, name, place, value):
    state = {key: np.array(array, dtype=float) for key, array in state.items()}
    state[name][place] = value
    return state


@pytest.mark.parametrize(("name", "place", "value", "says"), [
    ("sizes", 0, -1.0, "sizes > 0"),
    ("sizes", 0, 0.0, "sizes > 0"),
    ("counts", (0, 0), -1.0, "counts >= 0"),
    ("controls", (1, 0), np.nan, "a control of every entry that is controlled"),
    ("keys", (2, 0), 1e300, "nanoseconds hold"),
    ("kind", (), 7.0, "kind 0, 1 or 2"),
])  # fmt: skip
def test_a_fusion_refuses_and_stays(name, place, value, says):
    fusion = driven()
    before = fusion.estimate()
    with pytest.raises(ValueError, match=f"state: expected .*{says}"):
        fusion.restore(changed(fusion.state(), name, place, value))
    np.testing.assert_array_equal(fusion.estimate().x, before.x)


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
