"""How often the recent past is judged anew: that costs thousands of steps, and nothing sound asks for it."""

import numpy as np
import pytest

from robust_filterpy.fusion import Fusion, Sensor, _faults, constant_velocity


@pytest.mark.parametrize("off, fewest, most", [(0.0, 0, 1), (1.5, 1, 20)])
def test_sound_sensors_with_outliers_bring_no_looks_and_a_bias_few(monkeypatch, off, fewest, most):
    looks, judged = [], _faults.judged
    monkeypatch.setattr(_faults, "judged", lambda *given: looks.append(1) or judged(*given))
    rng, sensors = np.random.default_rng(8), {name: Sensor([1.0, 0.0], R=0.09) for name in "abc"}
    fusion = Fusion(constant_velocity(1, 0.02), sensors, 2.0, P0=100.0 * np.eye(2), watch=True)
    for k in range(450):
        z = 0.05 * k + 0.3 * rng.normal() + 10.0 * (rng.random() < 0.1) + off * (k > 350 and k % 3 == 1)
        fusion.observe("abc"[k % 3], 0.1 * k, z)
        fusion.estimate()
    assert fewest <= len(looks) <= most
    assert (fusion.verdicts()["b"].fault == "biased") == bool(off)
