"""Bands for what is to come hold as often as they say, where Q and R are wrong too."""

import numpy as np
import pytest
import support

from robust_filterpy.fusion import Fusion, Sensor, angle, constant_velocity
from robust_filterpy.influence import Linear


def path(seed, steps, outliers=0.0):
    """Where a point is and what is read of it, once a second; q = .1, sigma = 1."""
    rng, (F, Q, _) = np.random.default_rng(seed), constant_velocity(1, 0.1).matrices(1.0)
    places = support.states(F, rng.multivariate_normal(np.zeros(2), Q, steps))[:, 0]
    v = rng.normal(size=steps) * np.where(rng.random(steps) < outliers, 10.0, 1.0)
    return places, places + v


def made(q=0.1, R=1.0, **options):
    return Fusion(constant_velocity(1, q), {"gps": Sensor([1.0, 0.0], R=R)}, 2.0, P0=100.0 * np.eye(2), **options)


def test_bands_are_filterpys():
    fusion = made(influence=Linear())
    for t, z in enumerate(path(0, 8)[1]):
        fusion.observe("gps", float(t), z)
    found, state = fusion.forecast([7.0, 9.0], 0.9), fusion.estimate(9.0)
    half = 1.6448536 * np.sqrt([state.P[0, 0], state.P[0, 0] + 1.0])
    np.testing.assert_allclose(found.middle["gps"][1, 0], state.x[0])
    np.testing.assert_allclose(np.diff(found.signal["gps"][1, 0]) / 2.0, half[0], rtol=1e-6)
    np.testing.assert_allclose(np.diff(found.readings["gps"][1, 0]) / 2.0, half[1], rtol=1e-6)


@support.draws(1, 6)
@pytest.mark.parametrize(("q", "R", "outliers"), [(0.1, 1.0, 0.0), (0.1, 1.0, 0.1), (0.01, 10.0, 0.0)])
def test_bands_hold_on_clean_contaminated_and_misspecified_models(q, R, outliers, draws):
    ahead, inside = np.array([1.0, 5.0]), []
    for seed in range(draws):
        places, z = path(seed, 900, outliers)
        fusion = made(q, R)
        for t in range(890):
            fusion.observe("gps", float(t), z[t])
            if t > 500 and t % 40 == 0:
                found = fusion.forecast(t + ahead, 0.8)
                at = (t + ahead).astype(int)
                for band, value in ((found.readings, z[at]), (found.signal, places[at])):
                    low, high = band["gps"][:, 0].T
                    inside.append((low <= value) & (value <= high))
    held = np.array(inside).reshape(-1, 2, 2).mean(axis=(0, 2))
    # Runs of 9 forecasts each; .08 and .15 belong to six runs.
    wider = np.sqrt(6 / draws)
    assert abs(held[0] - 0.8) < 0.08 * wider and abs(held[1] - 0.8) < 0.15 * wider, held


def test_angles_noise_that_is_not_given_and_instants():
    north = {"h": lambda x: [np.arctan2(x[1], x[0])], "residual": angle,
             "jacobian": lambda x: np.array([[-x[1], x[0]]]) / (x @ x)}  # fmt: skip
    fusion = Fusion(
        constant_velocity(1, 0.1), {"b": Sensor(**north, R=0.01), "new": Sensor([1.0, 0.0])}, 1.0, x0=[-5.0, 0.01]
    )
    start = np.datetime64("2026-01-01T00:00:00", "ns")
    for k in range(3):
        fusion.observe("b", start + np.timedelta64(k, "s"), 3.1)
        fusion.observe("new", start + np.timedelta64(k, "s"), -5.0)
    found = fusion.forecast(start + np.timedelta64(4, "s"))
    assert abs(found.middle["b"][0, 0]) > 2.5 and np.isnan(found.readings["new"]).all()
    assert np.isfinite(found.signal["new"]).all() and found.signal["b"].shape == (1, 1, 2)


@pytest.mark.parametrize(("times", "level", "says"), [
    (3.0, 0.95, "from the newest stamp on"), (9.0, 95, "between 0 and 1"), (np.nan, 0.9, "times"), ([], 0.9, "times"),
    ("x", 0.9, "times"),
])  # fmt: skip
def test_what_cannot_be_forecast_is_refused(times, level, says):
    fusion = made()
    with pytest.raises(ValueError, match="reading first"):
        fusion.forecast(5.0)
    fusion.observe("gps", 4.0, 0.0)
    with pytest.raises((ValueError, TypeError), match=says):
        fusion.forecast(times, level)
