"""Recordings that mostly rest, are rounded by their sensor, or have no noise: step tests, pulses, simulations."""

import warnings

import numpy as np
import pytest
import support
from scipy.signal import lfilter

from robust_filterpy import Contaminated
from robust_filterpy.identification import (
    ARMAX,
    ARX,
    OutputError,
    ParameterTracker,
    StateSpace,
    compare,
    identify,
    validate,
)
from robust_filterpy.identification.models.noise import fit_percent
from robust_filterpy.identification.recursive.recursion import NoiseScale, followed, ordinary_mean
from robust_filterpy.influence.regression import mad_scale, resolution, robust_regression, size_of

B, A = [0.0, 1.0, 0.5], [1.0, -1.5, 0.7]
FRESH = np.random.default_rng(0).choice([-1.0, 1.0], 300)


def driven(kind, digits=None, steps=600):
    u = np.zeros(steps)
    if kind == "step":
        u[50:] = 1.0
    elif kind == "pulse":
        u[50:70] = 1.0
    else:
        u = np.where(np.arange(steps) // 100 % 2, 1.0, 0.0)
    y = lfilter(B, A, u)
    return (y if digits is None else y.round(digits)), u


def fresh_fit(model):
    response = model.simulate(FRESH) - model.simulate(np.zeros(FRESH.size))
    return fit_percent(lfilter(B, A, FRESH), np.ravel(response))


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("structure", [ARX(2, 2), OutputError(2, 2), StateSpace(2)], ids=["arx", "oe", "states"])
@pytest.mark.parametrize("kind", ["step", "pulse", "square"])
@pytest.mark.parametrize("digits, least", [(None, 99.999), (2, 99.8), (1, 98.5)])
def test_what_moves_for_a_while_is_no_outlier(structure, kind, digits, least):
    y, u = driven(kind, digits)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = identify(y, u, structure, progress=False)
    assert not model.findings
    assert fresh_fit(model) > least


def test_steps_of_a_sensor_bound_its_noise():
    y, u = driven("step", 1)
    model = identify(y, u, OutputError(2, 2))
    assert 0.1**2 / 12.0 <= model.noise.R < 0.1**2 / 6.0
    assert model.noise.is_rounding
    # The truth within the interval that this noise makes.
    assert (np.abs(model.theta - [-1.5, 0.7, 1.0, 0.5]) < 3.0 * model.std).all()


def test_a_recording_without_noise_leaves_nothing_to_be_judged():
    rng = np.random.default_rng(1)
    u = rng.choice([-1.0, 1.0], 600)
    y = lfilter(B, A, u)
    models = {str(s): identify(y, u, s) for s in (ARX(2, 2), OutputError(2, 2))}
    for model in models.values():
        assert not model.findings and not model.warning
        np.testing.assert_allclose(model.theta, [-1.5, 0.7, 1.0, 0.5], rtol=1e-12)
        assert validate(model, y, u).verdict == "nothing is left in the residuals"
        assert all(len(line) <= 78 for line in str(model.summary()).splitlines())
    assert min(row.fit for row in compare(models, y, u).rows) > 99.999
    # A wrong model of it leaves much.
    wrong = identify(y, u, OutputError(1, 1), trend="constant")
    assert validate(wrong, y, u).verdict != "nothing is left in the residuals"


def test_of_few_values_that_are_explained_the_steps_are_no_noise():
    u = np.random.default_rng(2).choice([-1.0, 1.0], 400)
    model = identify(lfilter([0.0, 2.0], [1.0], u), u, OutputError(0, 1))
    assert model.noise.R < 1e-20


def test_parameters_that_no_noise_tells_apart_are_named():
    u = np.random.default_rng(1).choice([-1.0, 1.0], 600)
    y = lfilter(B, A, u)
    with pytest.warns(UserWarning, match=r"a1, a2, a3, .*not determined by a recording without noise"):
        identify(y, u, ARX(3, 3))
    with pytest.warns(UserWarning, match="no noise but rounding: the coefficients of C and D"):
        identify(y, u, ARMAX(2, 2, 1))


def test_size_is_that_of_what_moves_where_the_median_rests():
    rng = np.random.default_rng(0)
    noisy = rng.normal(size=1000)
    wild = np.where(rng.random(1000) < 0.1, 1e9, noisy)
    for signal in (noisy, wild, noisy.round(1), np.where(np.arange(1000) == 500, 1e30, noisy)):
        assert size_of(signal) == mad_scale(signal)
    y = driven("pulse")[0]
    assert mad_scale(y) < 1e-9 and size_of(y) > 0.03
    assert size_of(driven("pulse", 1)[0]) > 0.03
    assert size_of(np.zeros(50)) == 0.0


@pytest.mark.parametrize("step", [1.0, 0.1, 1e-3])
def test_resolution_is_the_step_of_a_sensor(step):
    rng = np.random.default_rng(0)
    signal = step * np.round(20.0 * rng.normal(size=3000))
    signal[::97] = 5.0 * step * rng.normal(size=signal[::97].size)
    assert resolution(signal) == pytest.approx(step)
    assert resolution(rng.normal(size=100)) == 0.0 and resolution(np.ones(9)) == 0.0


@pytest.mark.parametrize("kind", ["step", "pulse"])
def test_a_tracker_at_rest_is_not_lost(kind):
    y, u = driven(kind, 2)
    tracker = ParameterTracker(OutputError(2, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tracker.run(y, u)
    np.testing.assert_allclose(tracker.theta[:4], [-1.5, 0.7, 1.0, 0.5], atol=0.02)


def test_after_a_rest_in_coarse_steps_what_moves_is_no_outlier():
    u = np.zeros(1500)
    u[60:110] = 1.0
    u[1200:] = -2.0
    y = lfilter(B, A, u).round(1)
    tracker = ParameterTracker(OutputError(2, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = tracker.run(y, u)
    assert result.weights[1200:1230].min() > 0.5
    assert tracker.R >= 0.1**2 / 12.0 * (1.0 - 1e-12)
    # Both ways, and from a state.
    other = ParameterTracker(OutputError(2, 2))
    other.run(y[:600], u[:600])
    third = ParameterTracker(OutputError(2, 2))
    third.restore(other.state())
    third.run(y[600:], u[600:])
    assert third.R == tracker.R


def test_a_model_of_a_few_samples_that_move_claims_nothing():
    u = np.zeros(800)
    u[188:] = 1.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ParameterTracker(ARX(2, 2)).run((7.3 * lfilter(B, A, u)).round(2), u)


def test_explained_to_the_last_bit_is_still_rounding_of_numbers():
    u = np.zeros(400)
    u[154:203] = 1.0
    y = 7.3 * lfilter([0.0, 0.2, 0.1], [1.0, -1.7, 0.72], u)
    assert identify(y, u, OutputError(2, 2)).noise.least > 1e-27


def test_an_r_that_is_followed_does_not_fall_below_what_is_rounding():
    scale = NoiseScale(samples=10.0, mean=ordinary_mean(None), memory=10.0, rounding=0.1)
    assert followed(0.001, scale, 0.0, 0.001)[0] == 0.1**2 / 12.0
    assert followed(0.001, scale._replace(rounding=0.0), 0.0, 0.001)[0] < 0.1**2 / 12.0


def test_the_mean_of_a_wide_mixture_is_no_difference_of_large_numbers():
    assert ordinary_mean(Contaminated(0.05, 5e9)) == pytest.approx(0.95 * ordinary_mean(None) + 0.05 * 4.0)


def test_gross_errors_do_not_stop_a_robust_regression():
    rng = np.random.default_rng(3)
    X = rng.normal(size=(400, 5))
    y = X @ np.arange(5.0) + 0.1 * rng.normal(size=400)
    y[::14] = 1e6 * rng.normal(size=y[::14].size)
    assert np.abs(robust_regression(X, y) - np.arange(5.0)).max() < 0.05


@pytest.mark.parametrize("by_kernel", [True, False])
@pytest.mark.parametrize("first", [0, 200])
@pytest.mark.parametrize("structure", [ARX(2, 2), OutputError(2, 2)], ids=str)
def test_while_input_and_output_rest_no_noise_is_learnt(structure, first, by_kernel, monkeypatch):
    if not by_kernel:
        support.without_kernel(monkeypatch)
    rng = np.random.default_rng(5)
    rests = slice(first, 3000 if by_kernel else 600)
    u = rng.choice([-1.0, 1.0], rests.stop + 400)
    u[rests] = 0.0
    y = lfilter(B, A, u) + 0.2 * rng.normal(size=u.size)
    y[first + 50 * bool(first) : rests.stop] = 0.0
    tracker = ParameterTracker(structure, start=0)
    tracker.run(y[: rests.stop], u[: rests.stop])
    assert 1e-4 < tracker.R <= 1.0
    tracker.run(y[rests.stop :], u[rests.stop :])
    np.testing.assert_allclose(tracker.theta, [-1.5, 0.7, 1.0, 0.5], atol=0.15)
    assert 0.02 < tracker.R < 0.5
