"""Frequency responses, poles and zeros are python-control's, and their bands hold the truth as often as they say."""

from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from numpy.testing import assert_allclose
from recordings import assert_refused

from robust_filterpy import ARX, OutputError, ParameterTracker, identify, plotting
from robust_filterpy.identification import ARMAX, FIR, BoxJenkins, LinearRegression

matplotlib.use("Agg")
import matplotlib.pyplot as plt

A, B = [1.0, -1.5, 0.7], [0.0, 1.0, 0.5]


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def recording(seed=1, samples=400):
    rng = np.random.default_rng(seed)
    u, y = rng.choice([-1.0, 1.0], samples), np.zeros(samples)
    for k in range(2, samples):
        y[k] = 1.5 * y[k - 1] - 0.7 * y[k - 2] + u[k - 1] + 0.5 * u[k - 2]
    return y + np.where(rng.random(samples) < 0.1, 10.0, 1.0) * rng.normal(size=samples), u


@pytest.fixture(scope="module")
def model():
    return identify(*recording(), OutputError(2, 2))


def line(ax, label):
    return next(line for line in ax.lines if line.get_label() == label)


@pytest.mark.parametrize("structure", [OutputError(2, 2), ARX(2, 2, 3), ARMAX(1, 2, 1), FIR(4), BoxJenkins(2, 0, 1, 2)])
def test_bode_is_that_of_control(structure):
    control = pytest.importorskip("control")
    found = identify(*recording(), structure)
    omega = np.geomspace(0.01, 3.0, 50)
    magnitude, phase = plotting.plot_bode({"it": found}, omega)
    expected = control.frequency_response(found.transfer_function(), omega)
    assert_allclose(line(magnitude, "it").get_ydata(), 20 * np.log10(np.abs(expected.complex)), atol=1e-9)
    turned = np.exp(1j * np.radians(line(phase, "it").get_ydata()))
    assert_allclose(turned, expected.complex / np.abs(expected.complex), atol=1e-9)


def test_bode_of_a_tracker_and_a_chosen_input(model):
    rng = np.random.default_rng(2)
    u = rng.choice([-1.0, 1.0], (300, 2))
    y = 3.0 * u[:, 0] - 2.0 * np.concatenate(([0.0], u[:-1, 1])) + 0.1 * rng.normal(size=300)
    tracker = ParameterTracker(FIR((1, 1), nk=(0, 1)), start=0)
    tracker.run(y, u)
    for which, gain in enumerate((3.0, 2.0)):
        magnitude, _ = plotting.plot_bode(tracker, which=which)
        assert_allclose(line(magnitude, str(tracker.structure)).get_ydata(), 20 * np.log10(gain), atol=0.1)


def test_the_sampling_period_is_on_the_axis(model):
    assert plotting.plot_bode(model)[1].get_xlabel() == "frequency [rad/sample]"
    axes = plotting.plot_bode({"it": replace(model, dt=0.1)})
    assert axes[1].get_xlabel() == "frequency [rad/s]"
    assert line(axes[0], "it").get_xdata()[-1] == pytest.approx(np.pi / 0.1)
    axes[0].figure.canvas.draw()
    assert axes[0].get_legend().get_window_extent().x0 >= axes[0].get_window_extent().x1


@pytest.mark.nightly
def test_bands_hold_the_true_response():
    """Of 20 recordings and 6 frequencies 95 % are to be within; a band of one standard deviation would hold 68 %."""
    omega = np.geomspace(0.02, 2.0, 6)
    z = np.exp(1j * omega)
    truth = 20 * np.log10(np.abs(np.polyval(B, z) / np.polyval(A, z)))
    inside = []
    for seed in range(20):
        ax = plotting.plot_bode(identify(*recording(100 + seed), OutputError(2, 2)), omega)[0]
        points = ax.collections[0].get_paths()[0].vertices
        for w, value in zip(omega, truth, strict=True):
            edge = points[np.isclose(points[:, 0], w), 1]
            inside.append(edge.min() <= value <= edge.max())
        plt.close("all")
    assert 0.85 <= np.mean(inside) <= 1.0


def test_poles_and_zeros_are_those_of_control(model):
    ax = plotting.plot_poles({"it": model})
    system = model.transfer_function()
    for label, expected in (("poles, it", system.poles()), ("zeros, it", system.zeros())):
        drawn = line(ax, label)
        found = drawn.get_xdata() + 1j * drawn.get_ydata()
        assert_allclose(np.sort_complex(found), np.sort_complex(expected), atol=1e-9)
    ax.figure.canvas.draw()
    assert ax.get_legend().get_window_extent().x0 >= ax.get_window_extent().x1


def test_regions_are_those_of_the_model(model):
    ax = plotting.plot_poles({"it": model}, level=0.9)
    edges = [one for one in ax.lines if len(one.get_xdata()) == 73]
    expected = np.concatenate((model.poles(0.9).ellipses(), model.zeros(0.9).ellipses()))
    assert_allclose([one.get_xdata() + 1j * one.get_ydata() for one in edges], expected)
    assert "90 % regions" in [text.get_text() for text in ax.get_legend().get_texts()]


def test_a_model_without_input_has_poles_only():
    y, _ = recording()
    labels = [one.get_label() for one in plotting.plot_poles({"it": identify(y, None, ARX(2, 0))}).lines]
    assert "poles, it" in labels and "zeros, it" not in labels


def test_a_frequency_response_draws_itself(model):
    found = model.frequency_response(np.linspace(0.0, 3.0, 20))
    magnitude, phase = found.plot()
    assert_allclose(line(magnitude, "response").get_ydata(), 20 * np.log10(found.magnitude))
    assert_allclose(line(phase, "response").get_ydata(), np.degrees(found.phase))
    assert line(magnitude, "response").get_xdata()[0] == 0.0


def test_the_period_of_the_recording_is_that_of_the_responses(model):
    slow = replace(model, dt=10.0)
    assert slow.frequency_response([0.1]).dt == slow.step_response(3).time[1] == slow.noise_spectrum([0.1]).dt == 10.0
    assert slow.frequency_response([0.1], dt=2.0).dt == 2.0 and model.frequency_response([0.1]).dt == 1.0
    with pytest.raises(ValueError, match="omega"):
        slow.frequency_response([1.0])


def test_a_model_that_has_no_response_is_refused(model):
    y, u = recording()
    with pytest.raises(ValueError, match=r"ARX.*: expected a model with an input"):
        plotting.plot_bode(identify(y, None, ARX(2, 0)))
    with pytest.raises(ValueError, match="which: expected an input below 1"):
        plotting.plot_bode(model, which=1)
    with pytest.raises(ValueError, match="input: expected 0 to 0"):
        plotting.plot_poles(model, which=1)
    for call in (plotting.plot_bode, plotting.plot_poles):
        with pytest.raises(ValueError, match="LinearRegression"):
            call(identify(y, u, LinearRegression(1)))
        with pytest.raises(ValueError, match="at its start"):
            call(ParameterTracker(OutputError(2, 2)))
    assert not plt.get_fignums()


def test_bad_arguments_are_refused_by_name_and_nothing_is_drawn(model):
    wrong = {"models": [{}, "model", {"a": 3}], "level": [95]}
    assert_refused(plotting.plot_poles, {"models": model}, wrong)
    assert_refused(plotting.plot_bode, {"models": model}, wrong | {"omega": [[0.1, 4.0]]})
    # What the right arguments have drawn.
    assert len(plt.get_fignums()) == 2


def test_models_with_and_without_a_period_do_not_mix(model):
    with pytest.raises(ValueError, match="all with or all without a sampling period"):
        plotting.plot_bode({"a": model, "b": replace(model, dt=1.0)})
