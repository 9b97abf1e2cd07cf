"""What is left of a model has a colour of its own: trends, standard deviations and inputs are judged beside it."""

import warnings

import numpy as np
import pytest
from scipy.signal import lfilter
from support import by_night

from robust_filterpy.identification import ARX, LinearRegression, OutputError, identify
from robust_filterpy.identification.estimation.prediction_error import colour_of
from robust_filterpy.identification.estimation.trend import piecewise_level


def quiet(y, u, structure, **options):
    """Return the model, nothing written."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return identify(y, u, structure, progress=False, **options)


@pytest.mark.parametrize("trend", by_night([None, "line"], None))
def test_a_trend_leaves_a_slow_input_what_it_explains(trend):
    rng, t = np.random.default_rng([9, 0]), np.arange(1000)
    binary = rng.choice([-1.0, 1.0], 1000).repeat(10)[:1000]
    slow = 25.0 * np.sin(2.0 * np.pi * t / 900) + 0.05 * t + lfilter([1.0], [1.0, -0.99], rng.normal(size=1000))
    y = lfilter([0.0, 0.05], [1.0, -0.95], binary) + lfilter([0.0, 0.03], [1.0, -0.95], slow) - 0.02 * t
    model = quiet(
        y + 0.15 * rng.normal(size=1000), np.column_stack((binary, slow)), OutputError(1, (1, 1)), trend=trend
    )
    assert abs(model.theta[2] - 0.03) < 3.0 * model.std[2]
    assert model.R < 0.027


def test_standard_deviations_count_that_residuals_follow_one_another():
    truth, inside = [-1.5, 0.7, 1.0, 0.5], []
    for seed in range(6):
        rng = np.random.default_rng([10, seed])
        u = rng.choice([-1.0, 1.0], 500).repeat(3)
        y = lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u) + lfilter([0.3], [1.0, -1.5, 0.7], rng.normal(size=1500))
        model = quiet(y, u, OutputError(2, 2), trend="constant")
        inside.append(np.abs(model.theta - truth) < 2.0 * model.std)
    assert np.mean(inside) >= 0.8
    assert model.colour > 1.3 and "Colored residuals" in str(model.summary())


def test_the_colour_of_white_noise_is_white_and_that_of_an_autoregression_is_it():
    white = np.random.default_rng(1).normal(size=2000)
    assert colour_of(white).polynomial.size == 1
    found = colour_of(lfilter([1.0], [1.0, -1.2, 0.5], white))
    np.testing.assert_allclose(found.polynomial, [1.0, -1.2, 0.5], atol=0.06)
    assert np.linalg.norm(found.response) == pytest.approx(1.0)
    assert found.gain == pytest.approx(
        1000.0 * np.log(np.var(lfilter([1.0], [1.0, -1.2, 0.5], white)) / np.var(white)), rel=0.05
    )


def test_slow_noise_and_the_steps_of_a_sensor_are_no_breaks_of_the_level():
    rng, none = np.random.default_rng(2), np.zeros((1500, 0))
    slow = lfilter([0.3], [1.0, -0.98], rng.normal(size=1500))
    assert not piecewise_level(slow, none).breaks
    rounded = 50.0 * np.round((60.0 * (np.arange(1500) >= 700) + rng.normal(size=1500)) / 100.0 + 0.2)
    assert not piecewise_level(rounded, none).breaks
    (one,) = piecewise_level(slow + 10.0 * (np.arange(1500) >= 700), none).breaks
    assert (one.kind, abs(one.time - 700) < 3, abs(one.size - 10.0) < 1.0) == ("step", True, True)


def test_rows_far_outside_that_y_does_not_follow_do_not_count_and_others_do():
    rng = np.random.default_rng(3)
    phi = rng.normal(size=(800, 2))
    phi[::100] *= 50.0
    y = phi @ [0.25, -0.1] + 0.05 * rng.normal(size=800)
    whole = quiet(y, phi, LinearRegression(2))
    assert not whole.findings
    spoilt = phi.copy()
    spoilt[rng.random(800) < 0.03, 0] = 1e3
    model = quiet(y, spoilt, LinearRegression(2))
    np.testing.assert_allclose(model.theta, [0.25, -0.1], atol=0.01)
    assert [one.kind for one in model.findings] == ["input outliers"]


@pytest.mark.parametrize("value", [1e9, -1e100, 1e300])
def test_one_impossible_reading_is_a_missing_one_and_a_shock_that_acts_on_is_not(value):
    rng = np.random.default_rng(4)
    u = rng.choice([-1.0, 1.0], 600)
    y = lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u) + lfilter([0.1], [1.0, -1.5, 0.7], rng.normal(size=600))
    y[300] = np.nan
    missing = quiet(y, u, ARX(2, 2))
    y[300] = value
    model = quiet(y, u, ARX(2, 2))
    np.testing.assert_array_equal(model.theta, missing.theta)
    assert [one.kind for one in model.findings] == ["wild"]


@pytest.mark.parametrize("noise", ["of the equation", "of the output", "slow"])
def test_an_arx_that_coloured_noise_biases_is_said(noise):
    rng, samples = np.random.default_rng([519, 4]), 800
    a, b, u = [1.0, -1.5, 0.7], [0.0, 1.0, 0.5], rng.choice([-1.0, 1.0], samples)
    white = np.where(rng.random(samples) < 0.05, 10.0, 1.0) * 0.2 * rng.normal(size=samples)
    slow = 0.9 * lfilter([0.3], [1.0, -0.95], rng.normal(size=samples))
    added = {"of the equation": lfilter([1.0], a, white), "of the output": 2.0 * white, "slow": slow + white}[noise]
    model = identify(lfilter(b, a, u) + added, u, ARX(2, 2), trend="constant")
    kinds = [one.kind for one in model.findings]
    assert kinds == [] if noise == "of the equation" else "noise that follows itself" in kinds
