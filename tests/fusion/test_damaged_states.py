"""A state that cannot be gone on from is refused by restore, and changes nothing."""

import numpy as np
import pytest

from robust_filterpy.fusion import Fusion, Sensor, constant_velocity


def made():
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
    fusion = made()
    before = fusion.estimate()
    with pytest.raises(ValueError, match=f"state: expected .*{says}"):
        fusion.restore(changed(fusion.state(), name, place, value))
    np.testing.assert_array_equal(fusion.estimate().x, before.x)
