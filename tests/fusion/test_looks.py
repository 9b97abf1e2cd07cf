"""How often the recent past is judged anew: that costs thousands of steps, and nothing sound asks for it."""

import numpy as np
import pytest
from scipy.stats import norm

from robust_filterpy.fusion import Fusion, Sensor, _faults, _watch, constant_velocity


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


def test_the_sums_of_a_reading_are_the_odds_of_grown_noise_and_of_more_outliers():
    scales, shares, spread, R, y = [1.0, 100.0], [0.9, 0.1], 0.5, 2.0, 4.0
    row = [1.5, 100.0, 1.0, 0.0, 0.0, 0.0, 9.0, 0.0, *shares, 0.2, 0.0, 0.1]
    after = _watch._after(row, 3.0, y, spread, R, scales, [], True)

    def densities(factor):
        return norm.pdf(y, scale=np.sqrt(spread + factor * 1.5 * R * np.array(scales)))

    ever = shares @ densities(1.0)
    others = [shares @ densities(4.0), shares @ densities(25.0), 0.75 * ever + 0.25 * densities(1.0)[1]]
    expected = np.maximum([0.2, 0.0, 0.1] + np.log(np.array(others) / ever), 0.0)
    np.testing.assert_allclose(after[-3:], expected, rtol=1e-12)
    assert after[_watch._NOISE] == pytest.approx(max(expected)) and max(expected) > 0.5 and after[1] == 101.0
    # Before the noise is learned nothing is summed; what repeats itself for long is as odd as that is rare.
    young = _watch._after([*row[:1], 59.0, *row[2:]], 3.0, y, spread, R, scales, [], True)
    assert young[-3:] == row[-3:]
    same = _watch._after([*row[:4], 4.0, 0.1, 3.0, *row[7:]], 3.0, 0.1, spread, R, scales, [], True)
    assert same[_watch._NOISE] == pytest.approx(-5.0 * np.log(0.1)) and same[4:6] == [5.0, 0.1]
