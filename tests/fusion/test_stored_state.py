"""A stored state of a fusion that is watched, with a doubt, is read and goes on to the same numbers."""

from pathlib import Path

import numpy as np
import pytest

from robust_filterpy.fusion import Fusion, Reacquisition, Sensor, constant_velocity


def test_a_fusion_goes_on_from_a_stored_state():
    stored = dict(np.load(Path(__file__).with_name("stored_fusion.npz")))
    x, P = stored.pop("then_x"), stored.pop("then_P")
    sensors = {"gps": Sensor([1.0, 0.0], R=1.0), "speed": Sensor([0.0, 1.0])}
    options = {"P0": np.eye(2), "watch": True, "reacquire": Reacquisition()}
    fusion, other = (Fusion(constant_velocity(1, q=0.1), sensors, 4.0, **options) for _ in range(2))
    fusion.restore(stored)
    now = fusion.state()
    # What is learned of a sensor had a number more when this was stored.
    assert stored.pop("memory").shape[1] == now["memory"].shape[1] + 1
    assert all(np.array_equal(now[name], part, equal_nan=True) for name, part in stored.items() if name != "moments")
    other.restore(now)
    assert all(np.array_equal(now[name], part, equal_nan=True) for name, part in other.state().items())
    # 113 numbers say what is in doubt, after one that says whether something is.
    assert len(stored["moments"]) == 13 and stored["moments"][-1, -114] == 1.0
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
