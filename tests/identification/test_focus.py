"""A focus: a model smaller than its plant is right in the band that was asked for, and says how surely."""

from functools import cache

import numpy as np
import pandas as pd
import pytest
import support
from scipy.signal import butter, lfilter, sosfilt

from robust_filterpy.identification import (
    AR,
    ARMAX,
    ARX,
    LinearRegression,
    OutputError,
    StateSpace,
    Structure,
    identify,
)

# A slow pole, and a resonance that a model of first order has no room for.
A, B = np.convolve([1.0, -0.95], [1.0, -1.2, 0.8]), np.array([0.0, 0.02, 0.05])
BAND = (None, 0.1)
PLAIN = Structure(nb=1, nf=1)

pytestmark = pytest.mark.filterwarnings("ignore:identify. between:UserWarning")


def recording(seed, samples=1500, share=0.1, a=A, b=B):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=samples)
    v = 0.05 * rng.normal(size=samples) * np.where(rng.random(samples) < share, 20.0, 1.0)
    return 3.0 + lfilter(b, a, u) + v, u


def far_off(model, low, high):
    """The relative error of the frequency response, over a band."""
    w = np.linspace(low, high, 30)
    truth = np.polyval(B[::-1], np.exp(-1j * w)) / np.polyval(A[::-1], np.exp(-1j * w))
    found = model.frequency_response(w, dt=1.0).response
    return float(np.sqrt(np.mean(np.abs(np.ravel(found) / truth - 1.0) ** 2)))


@pytest.mark.parametrize(("structure", "share"), [(ARX(1, 1), 0.1), (ARMAX(1, 1, 1), 0.0), (PLAIN, 0.1)])
def test_a_model_that_is_too_small_is_right_within_its_band(structure, share):
    y, u = recording(1, 1000, share)
    whole = identify(y, u, structure, trend="constant")
    model = identify(y, u, structure, focus=BAND, trend="constant")
    assert far_off(model, 0.005, 0.1) < 0.04
    # One step ahead is all about the resonance.
    assert far_off(whole, 0.005, 0.1) > (0.3 if structure.na else 0.015)
    assert model.focus == (0.0, 0.1) and "0 to 0.1 rad/sample" in str(model.summary()) and whole.focus is None


def test_outliers_are_replaced_before_they_are_smeared():
    y, u = recording(2, 1000, 0.2)
    sos = butter(2, 0.1, fs=2.0 * np.pi, output="sos")
    smeared = identify(sosfilt(sos, y), sosfilt(sos, u), OutputError(1, 1), trend="constant")
    assert far_off(identify(y, u, OutputError(1, 1), focus=BAND, trend="constant"), 0.005, 0.1) < 0.5 * far_off(
        smeared, 0.005, 0.1
    )


@support.draws(3, 10)
@pytest.mark.parametrize("focus", [pytest.param((0.1, 0.8), marks=pytest.mark.slow), (None, 0.3)])
def test_intervals_hold_though_filtered_residuals_carry_over(focus, draws):
    truth, inside = np.array([-0.8, 1.0]), []
    for seed in range(draws):
        y, u = recording(100 + seed, 400, a=np.array([1.0, -0.8]), b=np.array([0.0, 1.0]))
        model = identify(y, u, OutputError(1, 1), focus=focus, trend="constant")
        inside.append(np.abs(model.theta - truth) < 1.96 * model.std)
    assert np.mean(inside) >= 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / (2 * draws))


def test_noise_level_and_weights_are_those_of_the_recording():
    y, u = recording(3, 800, a=np.array([1.0, -0.8]), b=np.array([0.0, 1.0]))
    whole, model = identify(y, u, OutputError(1, 1)), identify(y, u, OutputError(1, 1), focus=(None, 1.0))
    assert model.R == pytest.approx(whole.R, rel=0.1) and model.offset == pytest.approx(whole.offset, abs=0.01)
    assert np.corrcoef(model.weights[5:], whole.weights[5:])[0, 1] > 0.95 and model.weights.size == y.size
    assert model.fit(y, u) > whole.fit(y, u) - 0.2


@cache
def unbroken():
    return identify(*recording(11, 1200), OutputError(1, 1), focus=BAND)


def broken(name, y, u):
    """A recording that breaks an assumption, and a structure for it."""
    structure = OutputError(1, 1)
    if name == "drift":
        return y + np.cumsum(0.02 * np.random.default_rng(0).normal(size=y.size)), u, OutputError(1, 1, integrated=True)
    if name == "fill values":
        y = np.where(np.arange(y.size) % 12, y, 9999.0)
    elif name == "level step":
        y = y + 4.0 * np.std(y) * (np.arange(y.size) > 0.5 * y.size)
    elif name == "input far from 0":
        u = u + 1e4
    return y, u, structure


@pytest.mark.filterwarnings("ignore:identify:UserWarning")
@pytest.mark.parametrize("name", ["drift", "fill values", "level step", "input far from 0"])
def test_what_breaks_a_recording_does_not_break_the_band(name):
    y, u, structure = broken(name, *recording(11, 1200))
    model, plain = identify(y, u, structure, focus=BAND), unbroken()
    assert far_off(model, 0.005, 0.1) < 0.03
    # A drift tells less of low frequencies, and the model says so.
    assert (model.std[:2] > 0.9 * plain.std).all() and (
        model.std[:2] < (6.0 if name == "drift" else 1.3) * plain.std
    ).all()


def test_R_is_that_of_the_noise_and_not_of_what_a_small_model_leaves():
    y, u = recording(11, 1200)
    model = identify(y, u, OutputError(1, 1), R=0.0025, focus=BAND)
    assert far_off(model, 0.005, 0.1) < 0.03 and model.R == 0.0025


def test_gaps_delays_and_several_inputs():
    rng = np.random.default_rng(4)
    u = rng.normal(size=(600, 2))
    y = lfilter([0.0, 0.0, 0.5], [1.0, -0.8], u[:, 0]) + lfilter([0.0, 1.0], [1.0, -0.8], u[:, 1])
    y += 0.05 * rng.normal(size=600)
    y[200:208] = np.nan
    model = identify(y, u, OutputError(1, (1, 1), nk=(2, 1)), focus=(0.0, 0.5))
    np.testing.assert_allclose(model.theta, [-0.8, 0.5, 1.0], atol=0.03)


def test_what_is_known_stays_known():
    y, u = recording(5, 500, a=np.array([1.0, -0.8]), b=np.array([0.0, 1.0]))
    with pytest.warns(UserWarning, match="b1 ended at a bound"):
        model = identify(y, u, PLAIN, focus=BAND, trend="constant", fixed={"f1": -0.7}, bounds={"b1": (0.0, 0.5)})
    found = dict(zip(model.structure.names, model.theta, strict=True))
    assert found["f1"] == -0.7 and found["b1"] == pytest.approx(0.5)


def test_the_band_is_in_the_unit_of_the_index():
    y, u = recording(6, 500)
    index = pd.timedelta_range(0, periods=len(y), freq="100ms")
    timed = identify(pd.Series(y, index), pd.Series(u, index), OutputError(1, 1), focus=(None, 1.0))
    np.testing.assert_allclose(timed.theta, identify(y, u, OutputError(1, 1), focus=(None, 0.1)).theta)
    assert "0 to 1 rad/s" in str(timed.summary())


@pytest.mark.parametrize(
    ("structure", "focus", "error", "words"),
    [
        (OutputError(1, 1), 0.1, TypeError, r"focus: expected \(low, high\)"),
        (OutputError(1, 1), (0.5, 0.1), ValueError, "low < high"),
        (OutputError(1, 1), (0.0, 4.0), ValueError, "rad a sample"),
        (OutputError(1, 1), (None, None), ValueError, "not all of that"),
        (OutputError(1, 1), (None, 1e-4), ValueError, "settles within a quarter"),
        (OutputError(1, 1), (None, "1"), TypeError, "focus"),
        (Structure(na=1, nb=1, nf=1), BAND, ValueError, "A or F alone"),
        (StateSpace(), BAND, ValueError, "focus: expected a StateSpace with a number of states"),
        (StateSpace(1, disturbance=True), BAND, ValueError, "focus: expected a StateSpace without disturbance"),
        (StateSpace(1), (0.5, 0.1), ValueError, "low < high"),
    ],
)
def test_what_has_no_band_is_refused(structure, focus, error, words):
    y, u = recording(7, 400)
    with pytest.raises(error, match=words):
        identify(y, u, structure, focus=focus)


def test_structures_without_dynamics_and_several_recordings_are_refused():
    y, u = recording(8, 400)
    with pytest.raises(ValueError, match="no dynamics"):
        identify(y, None, AR(1), focus=BAND)
    with pytest.raises(ValueError, match="no dynamics"):
        identify(y, u[:, None], LinearRegression(1), focus=BAND)
    for structure in (OutputError(1, 1), StateSpace(1)):
        with pytest.raises(ValueError, match="one recording"):
            identify([y, y], [u, u], structure, focus=BAND)


def test_states_of_several_outputs_are_right_within_the_band():
    y, u = recording(21, 1000)
    other = 0.5 * lfilter(B, A, u) + 0.05 * np.random.default_rng([21, 1]).normal(size=1000)
    other[200:210] = np.nan
    whole, model = (identify(np.column_stack((y, other)), u, StateSpace(1), focus=band) for band in (None, BAND))
    one = identify(y, u, StateSpace(1), focus=BAND)
    assert far_off(one, 0.005, 0.1) < min(0.02, 0.7 * far_off(identify(y, u, StateSpace(1)), 0.005, 0.1))
    assert far_off(model, 0.005, 0.1) < far_off(whole, 0.005, 0.1)
    assert model.focus == (0.0, 0.1) and "0 to 0.1 rad/sample" in str(model.summary()) and whole.focus is None
    # The level is that of the recording, and K is none.
    np.testing.assert_allclose(model.level, [3.0, 0.0], atol=0.05)
    np.testing.assert_array_equal(model.K, 0.0)


@support.draws(3, 10)
def test_intervals_of_states_hold_though_filtered_residuals_carry_over(draws):
    inside = []
    for seed in range(draws):
        y, u = recording(100 + seed, 400, a=np.array([1.0, -0.8]), b=np.array([0.0, 1.0]))
        model = identify(y, u, StateSpace(1), focus=(None, 0.3), trend="constant")
        step = model.step_response(2)
        inside += [abs(model.A[0, 0] - 0.8) < 1.96 * model.std[0], step.lower[1] < 1.0 < step.upper[1]]
    assert np.mean(inside) >= 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / (2 * draws))
