"""What a control engineer asks any identified model for: zeros, spectra of noise, fewer states, tables, pictures."""

from __future__ import annotations

import sys
from dataclasses import replace

import control
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
import recordings
from recordings import A, B
from scipy.signal import lfilter, welch
from scipy.stats import norm

from robust_filterpy import plotting
from robust_filterpy.identification import ARX, FIR, GreyBox, OutputError, ParameterTracker, StateSpace, identify
from robust_filterpy.identification.estimation.outputs import _driven

matplotlib.use("Agg")


def recording(seed=0, samples=400, inputs=1):
    rng = np.random.default_rng([93, seed])
    u = rng.choice([-1.0, 1.0], (samples, inputs))
    y = np.column_stack((lfilter(B, A, u[:, 0]), lfilter([0.0, 0.5, 0.2], A, u[:, -1])))
    return rng, y, u


@pytest.fixture(scope="module")
def driven():
    """Two outputs whose states are driven by noise, and their model."""
    rng, y, u = recording(1, 1000)
    y = y + lfilter([1.0], [1.0, -0.8], 0.3 * rng.normal(size=y.shape), axis=0)
    return identify(y, u, StateSpace(4, disturbance=True)), y, u


@pytest.fixture(scope="module")
def square():
    rng, y, u = recording(2, inputs=2)
    y[:, 0] += lfilter([0.0, 0.3, 0.2], A, u[:, 1])
    return identify(y + 0.05 * rng.normal(size=y.shape), u, StateSpace(4)), y, u


def test_zeros_of_states_are_python_controls(square):
    model = square[0]
    system = model.to_control()
    np.testing.assert_allclose(np.sort(model.zeros().values), np.sort(system.zeros()), rtol=1e-9)
    way = control.ss(model.A, model.B[:, [1]], model.C[[0]], model.D[[0]][:, [1]], True)
    found = model.zeros(input=1, output=0)
    np.testing.assert_allclose(found.values, way.zeros()[np.abs(way.zeros()) < 1e6], rtol=1e-9)
    near = np.abs(found.values + 2.0 / 3.0).argmin()
    assert found.contains(np.full(found.values.size, -2.0 / 3.0 + 0j))[near] and found.std[near, 0] > 0.0
    with pytest.raises(ValueError, match="input: expected 0 to 1, got 2"):
        model.zeros(input=2)


def test_zeros_of_more_outputs_than_inputs_need_slycot_or_a_way(driven, monkeypatch):
    monkeypatch.setitem(sys.modules, "slycot", None)
    with pytest.raises(ValueError, match="python-control needs slycot; install it, or name input= and output="):
        driven[0].zeros()
    assert np.abs(driven[0].zeros(input=0, output=0).values + 0.5).min() < 0.1


def test_the_noise_spectrum_of_states_is_that_of_what_inputs_leave(driven):
    model, y, u = driven
    w = np.linspace(0.2, 3.0, 15)
    for output in (0, 1):
        found = model.noise_spectrum(w, output)
        left = y[:, output] - model.free_run(y, u)[:, output]
        f, power = welch(left, nperseg=128, return_onesided=False)
        expected = np.interp(w / (2.0 * np.pi), f[:64], power[:64])
        np.testing.assert_allclose(np.log(found.density), np.log(expected), atol=0.7)
        true = 0.09 / np.abs(1.0 - 0.8 * np.exp(-1j * w)) ** 2
        assert ((found.lower < true) & (true < found.upper)).mean() > 0.8
    # Its power is that of the innovations where there is no disturbance.
    plain = identify(*recording(3)[1:], StateSpace(2)).noise_spectrum([0.1, 2.0], 1)
    np.testing.assert_allclose(plain.density[0], plain.density[1])
    with pytest.raises(ValueError, match="output: expected 0 to 1"):
        model.noise_spectrum(w, 2)


def test_a_deviation_of_the_output_stands_in_the_innovations_as_the_predictor_passes_it_on(driven):
    model, x, expected = driven[0], np.zeros(4), []
    deviation = np.random.default_rng(0).normal(size=(40, 2))
    for row in deviation - deviation.mean(axis=0):
        expected.append(row - model.C @ x)
        x = model.A @ x + model.K @ expected[-1]
    np.testing.assert_allclose(_driven(model, deviation), expected, rtol=1e-9, atol=1e-12)


def test_each_kind_of_model_has_the_same_table_and_predicts(square):
    y, u = square[1][:120], square[2][:120]
    t = np.arange(120) * 1.0
    physics = GreyBox(lambda x, u, p: [p[0] * (p[1] * u[0] - x[0])], {"rate": 0.3, "gain": 1.0}, x0=[0.0])
    first = lfilter([0.0, 0.26], [1.0, -0.74], u[:, 0]) + 0.05 * np.random.default_rng(6).normal(size=120)
    grey = identify(first, u[:, 0], physics, t=t)
    for model in (square[0], identify(y[:, 0], u, OutputError(2, (2, 2))), grey):
        frame = model.to_frame()
        assert list(frame.columns) == ["estimate", "std", "z", "lower", "upper"] and len(frame) >= model.theta.size
        np.testing.assert_array_equal(frame["estimate"].iloc[: model.theta.size], model.theta)
        assert (model.to_frame(0.5)["upper"] <= frame["upper"]).all()
    # A physical model has no noise between samples: it predicts from inputs alone.
    np.testing.assert_array_equal(grey.predict(first, u[:, 0], 5, t), grey.free_run(first, u[:, 0], t))
    with pytest.raises(ValueError, match="steps"):
        grey.predict(first, u[:, 0], 0, t)


def test_pictures_of_states(driven, square):
    magnitude, _ = plotting.plot_bode({"it": square[0]}, [0.1, 1.0], which=1, output=1)
    expected = square[0].frequency_response([0.1, 1.0], output=1).magnitude[1]
    np.testing.assert_allclose(magnitude.lines[0].get_ydata(), 20.0 * np.log10(expected))
    ax = plotting.plot_poles({"it": square[0]}, output=1, which=1)
    drawn = {line.get_label(): line.get_xdata() + 1j * np.asarray(line.get_ydata()) for line in ax.lines}
    np.testing.assert_allclose(drawn["zeros, it"], square[0].zeros(input=1, output=1).values)
    found = driven[0].noise_spectrum(np.geomspace(0.01, 3.0, 20), 1)
    ax = found.plot()
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), found.density)
    assert ax.get_xscale() == ax.get_yscale() == "log"
    plt.close("all")


# A model, states and a tracker are systems: what one of them tells the others tell.


Y, U = recordings.recording(5, 200, share=0.0, sigma=0.05, a=[1.0, -0.5], b=[0.0, 2.0])


def test_a_tracker_has_poles_in_continuous_time_and_a_summary():
    tracker = ParameterTracker(ARX(1, 1), theta=[-0.5, 2.0], P=0.01, R=0.1)
    assert tracker.poles(dt=0.1).values == pytest.approx(np.log(0.5) / 0.1)
    rows = tracker.summary().rows
    assert [(row.name, row.estimate, row.std) for row in rows] == [("a1", -0.5, 0.1), ("b1", 2.0, 0.1)]
    assert "has not found a model" in str(ParameterTracker(FIR(1)).summary())


@pytest.mark.parametrize("structure", [OutputError(1, 1), StateSpace(1)], ids=["polynomials", "states"])
def test_equal_steps_of_time_change_nothing_and_others_are_refused_as_are_outputs_that_are_not_there(structure):
    model, t = identify(Y, U, structure), 0.1 * np.arange(200)
    np.testing.assert_array_equal(model.predict(Y, U, t=t), model.predict(Y, U))
    np.testing.assert_array_equal(model.fit(Y, U, t), model.fit(Y, U))
    with pytest.raises(ValueError, match="t: expected equal steps"):
        model.free_run(Y, U, t**2)
    with pytest.raises(TypeError, match=r"output: .* level= goes by its name"):
        model.frequency_response([0.1], 0.9)
    for call in (model.step_response, model.noise_spectrum):
        with pytest.raises(ValueError, match="output: expected 0 to 0, got 1"):
            call([0.1] if call == model.noise_spectrum else 5, output=1)


# The summary of a model shows its own numbers, as a table that fits a screen.


@pytest.fixture(scope="module")
def model():
    y, u = recordings.recording(3, 500, sigma=0.2, a=[1.0, -0.5], b=[0.0, 1.0])
    y[::50] = np.nan
    return identify(3.0 + y, u, OutputError(1, 1))


def test_rows_are_the_parameters_and_the_offset(model):
    rows = model.summary(level=0.9).rows
    assert [row.name for row in rows] == ["a1", "b1", "offset"]
    half = norm.ppf(0.95)
    for row, value, std in zip(rows, [*model.theta, model.offset], [*model.std, model.offset_std], strict=True):
        assert (row.estimate, row.std, row.z) == (value, std, pytest.approx(value / std))
        assert (row.lower, row.upper) == (pytest.approx(value - half * std), pytest.approx(value + half * std))


def test_the_text_fits_a_screen_and_says_everything(model):
    text = str(model.summary())
    assert repr(model.summary()) == text and max(map(len, text.splitlines())) <= 78
    known = int((~np.isnan(model.weights)).sum())
    for part in ("OutputError(na=1, nb=1, nk=1)", f"{known} of 500", f"{model.R:.4g}", " 2.5 %", "97.5 %", "Fit, 1"):
        assert part in text
    assert "Doubtful" not in text and "Doubtful: two models" in str(replace(model, warning="two models").summary())


def test_own_fit_is_that_of_the_ordinary_samples(model):
    # Noise .2 with a signal of variance 1/(1 - .25).
    assert model.own_fit == pytest.approx(100 * (1 - 0.2 / np.sqrt(4 / 3 + 0.04)), abs=2.0)


@pytest.mark.parametrize("structure", [OutputError(2, 2), ARX(2, 2)], ids=str)
def test_a_parameter_that_is_held_has_no_z_and_the_table_says_held(structure):
    y, u = recordings.recording(4, share=0.0, sigma=0.1)
    summary = identify(y, u, structure, fixed={"a1": -1.5}).summary()
    held, *free = summary.rows
    assert (held.name, held.estimate, held.std, held.lower, held.upper) == ("a1", -1.5, 0.0, -1.5, -1.5)
    assert np.isnan(held.z)
    assert all(np.isfinite(row.z) and row.std > 0.0 for row in free)
    said = {line.split()[0]: line.split()[1:] for line in str(summary).splitlines() if line.startswith(("a", "b"))}
    assert said["a1"] == ["-1.5", "held"]
    assert all(len(said[row.name]) == 5 for row in free if row.name != "offset")
    assert "inf" not in str(summary)

