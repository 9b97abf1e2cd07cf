"""Pictures of the workbench show the numbers of their results, on the user's time axis, legends outside the data."""

from dataclasses import replace

import matplotlib
import numpy as np
import pytest
import recordings
from numpy.testing import assert_allclose, assert_array_equal
from recordings import assert_refused

from robust_filterpy import ARX, OutputError, ParameterTracker, identify, plotting
from robust_filterpy.identification import FIR, LinearRegression, StateSpace, compare, select_structure, validate

matplotlib.use("Agg")
import matplotlib.pyplot as plt

pd = pytest.importorskip("pandas")


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def recording():
    y, u = recordings.recording(1, 600, sigma=0.5)
    return pd.DataFrame({"y": y, "u": u}, index=pd.date_range("2024-03-01", periods=600, freq="10s"))


@pytest.fixture(scope="module")
def model(recording):
    return identify(recording.y, recording.u, OutputError(2, 2))


def labels(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def assert_outside_the_data(ax):
    ax.figure.canvas.draw()
    assert ax.get_legend().get_window_extent().x0 >= ax.get_window_extent().x1


def test_validation_marks_exactly_what_is_outside(recording):
    found = validate(identify(recording.y, recording.u, OutputError(1, 1)), recording.y, recording.u)
    axes = found.plot()
    assert len(axes) == 2
    pairs = (found.autocorrelation, found.autocorrelation_bound), (found.cross_correlation[0], found.cross_bound[0])
    for ax, (values, bound), first in zip(axes, pairs, (1, 0), strict=True):
        outside = np.abs(values) > bound
        assert 0 < outside.sum() < outside.size
        marked = next(line for line in ax.lines if line.get_label() == "outside")
        assert_array_equal(marked.get_ydata(), values[outside])
        assert_array_equal(marked.get_xdata(), np.flatnonzero(outside) + first)
        assert labels(ax) == ["99 % bound", "within", "outside"]
        assert_outside_the_data(ax)
    assert axes[1].get_xlabel() == "lag [samples]"
    with pytest.raises(ValueError, match="axes: expected 2 matplotlib axes, got 1"):
        found.plot(axes=plt.figure().subplots())
    given = plt.figure().subplots(2)
    assert list(found.plot(axes=given)) == list(given)
    assert "dynamics are missing" in axes[0].figure.get_suptitle()


def test_validation_has_a_picture_for_each_input_and_one_without(recording):
    both = recording[["u"]].assign(w=np.random.default_rng(2).normal(size=600))
    found = validate(identify(recording.y, both, FIR((3, 3))), recording.y, both)
    assert [ax.get_title() for ax in found.plot()] == [
        "residuals among themselves", "input 0 and residuals", "input 1 and residuals",
    ]  # fmt: skip
    alone = validate(identify(recording.y, None, ARX(2, 0)), recording.y)
    assert len(alone.plot()) == 1


def test_each_of_several_outputs_has_a_picture(recording):
    both = recording[["y"]].assign(w=3.0 - 2.0 * recording.y)
    model = identify(both, recording.u, StateSpace(2))
    axes = validate(model, both, recording.u).plot()
    assert axes.shape == (2, 2)
    assert [own[0].figure.get_suptitle()[:10] for own in axes] == ["output 0: ", "output 1: "]
    found = compare({"states": model}, both, recording.u)
    ax = found.plot(output=1)
    measured = next(line for line in ax.lines if line.get_label() == "measured")
    assert_array_equal(measured.get_ydata(), both.w)
    assert_array_equal(ax.lines[0].get_ydata(), found.outputs["states"][:, 1])
    with pytest.raises(ValueError, match="output: expected 0 to 1, got 2"):
        found.plot(output=2)


def test_selection_shows_every_structure_and_rings_the_chosen(recording):
    found = select_structure(recording.y, recording.u, na=[1, 2], nk=[1])
    fit, criterion, response = found.plot()
    for ax, name in ((fit, "fit"), (criterion, "criterion")):
        drawn = np.concatenate([line.get_ydata() for line in ax.lines if line.get_label() in ("tried", "first b is 0")])
        expected = [getattr(row, name) for row in found.rows]
        if name == "criterion":
            expected = np.array(expected) - found.rows[0].criterion
        assert sorted(drawn) == pytest.approx(sorted(expected))
    ring = next(line for line in fit.lines if line.get_label() == "chosen")
    assert (ring.get_xdata()[0], ring.get_ydata()[0]) == (4, found.rows[0].fit)
    assert fit.get_title() == "chosen: OutputError(na=2, nb=2, nk=1)"
    assert (criterion.get_ylabel(), criterion.get_xlabel()) == ("bic above the best", "parameters")
    assert "chosen delay, 1" in labels(response)
    assert_outside_the_data(fit)
    # Without input there is no impulse response.
    assert len(select_structure(recording.y, None, ARX, na=[1, 2]).plot()) == 2
    assert_outside_the_data(response)


def test_comparison_has_dates_fits_and_units(recording, model):
    found = compare({"two": model, "none": identify(recording.y, recording.u, FIR(1))}, recording.y, recording.u)
    ax = found.plot(unit="mm")
    assert labels(ax) == [*(f"{row.name}, fit {row.fit:.1f} %" for row in found.rows), "measured"]
    assert_array_equal(ax.lines[0].get_xdata(orig=True), recording.index.to_numpy())
    assert_array_equal(ax.lines[0].get_ydata(), found.outputs["two"])
    assert (ax.get_ylabel(), ax.get_xlabel()) == ("output [mm]", "time")
    assert isinstance(ax.xaxis.get_major_formatter(), matplotlib.dates.ConciseDateFormatter)
    assert_outside_the_data(ax)
    # An outlier does not flatten the outputs.
    wild = recording.y.copy()
    wild.iloc[10] = 1e6
    assert compare({"two": model}, wild, recording.u).plot().get_ylim()[1] < 100.0


def test_a_run_has_the_names_and_the_dates_of_its_recording(recording):
    result = ParameterTracker(ARX(1, 1), start=0, R=0.25).run(recording.y, recording.u)
    ax = result.plot()
    assert labels(ax) == ["±2 sigma", "a1", "b1"]
    assert_array_equal(ax.lines[0].get_xdata(orig=True), recording.index.to_numpy())
    assert plotting.plot_weights(result).get_xlabel() == "time"


@pytest.mark.parametrize(("index", "label"), [
    (pd.date_range("2024-03-30", periods=3, freq="h", tz="Europe/Berlin"), "time"),
    (pd.period_range("2024-01", periods=3, freq="M"), "time"),
    ([pd.Timestamp("2024-01-01").to_pydatetime()] * 3, "time"),
    (pd.timedelta_range("0s", periods=3, freq="500ms"), "sample"),
    (pd.RangeIndex(3), "sample"),
], ids=["hours of a place", "periods", "datetimes", "durations", "count"])  # fmt: skip
def test_times_of_all_kinds_stand_on_the_axis(index, label):
    ax = plotting.plot_weights(np.ones(3), t=index)
    assert ax.get_xlabel() == label
    if isinstance(index, pd.TimedeltaIndex):
        assert_array_equal(ax.lines[0].get_xdata(), [0.0, 0.5, 1.0])
    if getattr(index, "tz", None) is not None:
        assert ax.lines[0].get_xdata(orig=True)[0] == np.datetime64("2024-03-30T00:00")


# Responses: the numbers are those of the model, their bands too.


@pytest.fixture(scope="module")
def plain(model):
    """The model of samples that have no times."""
    return replace(model, dt=None)


def line(ax, label):
    return next(line for line in ax.lines if line.get_label() == label)


def test_bode_of_a_tracker_and_a_chosen_input(plain):
    rng = np.random.default_rng(2)
    u = rng.choice([-1.0, 1.0], (300, 2))
    y = 3.0 * u[:, 0] - 2.0 * np.concatenate(([0.0], u[:-1, 1])) + 0.1 * rng.normal(size=300)
    tracker = ParameterTracker(FIR((1, 1), nk=(0, 1)), start=0)
    tracker.run(y, u)
    for which, gain in enumerate((3.0, 2.0)):
        magnitude, _ = plotting.plot_bode(tracker, which=which)
        assert_allclose(line(magnitude, str(tracker.structure)).get_ydata(), 20 * np.log10(gain), atol=0.1)


def test_the_sampling_period_is_on_the_axis(plain):
    assert plotting.plot_bode(plain)[1].get_xlabel() == "frequency [rad/sample]"
    axes = plotting.plot_bode({"it": replace(plain, dt=0.1)})
    assert axes[1].get_xlabel() == "frequency [rad/s]"
    assert line(axes[0], "it").get_xdata()[-1] == pytest.approx(np.pi / 0.1)
    assert_outside_the_data(axes[0])


def test_poles_zeros_and_regions_are_those_of_the_model(plain):
    ax = plotting.plot_poles({"it": plain}, level=0.9)
    for label, of in (("poles, it", plain.poles), ("zeros, it", plain.zeros)):
        drawn = line(ax, label).get_xdata() + 1j * line(ax, label).get_ydata()
        assert_allclose(np.sort_complex(drawn), np.sort_complex(of().values))
    edges = [one for one in ax.lines if len(one.get_xdata()) == 73]
    expected = np.concatenate((plain.poles(0.9).ellipses(), plain.zeros(0.9).ellipses()))
    assert_allclose([one.get_xdata() + 1j * one.get_ydata() for one in edges], expected)
    assert "90 % regions" in [text.get_text() for text in ax.get_legend().get_texts()]
    assert_outside_the_data(ax)


def test_a_model_without_input_has_poles_only(recording):
    labels = [one.get_label() for one in plotting.plot_poles({"it": identify(recording.y, None, ARX(2, 0))}).lines]
    assert "poles, it" in labels and "zeros, it" not in labels


def test_a_frequency_response_draws_itself_with_its_bands(plain):
    found = plain.frequency_response(np.linspace(0.0, 3.0, 20))
    magnitude, phase = found.plot()
    for axes in ((magnitude, phase), plotting.plot_bode({"response": plain}, found.omega)):
        for ax, unit, name in ((axes[0], lambda x: 20 * np.log10(x), "magnitude"), (axes[1], np.degrees, "phase")):
            drawn = line(ax, "response")
            assert_allclose(drawn.get_xdata(), found.omega)
            assert_allclose(drawn.get_ydata(), unit(getattr(found, name)))
            band = ax.collections[0].get_paths()[0].vertices
            for end, of in (("lower", np.min), ("upper", np.max)):
                edges = [of(band[np.isclose(band[:, 0], w), 1]) for w in found.omega[1:-1]]
                assert_allclose(edges, unit(getattr(found, f"{name}_{end}"))[1:-1])


def test_a_step_response_is_drawn_in_steps_and_a_spectrum_as_a_line(plain):
    step, spectrum = plain.step_response(8), plain.noise_spectrum(np.linspace(0.1, 3.0, 20))
    for found, x, y, look in ((step, step.time, "response", "steps-post"),
                              (spectrum, spectrum.omega, "density", "default")):  # fmt: skip
        drawn, edges = line(ax := found.plot(), y), ax.collections[0].get_paths()[0].vertices[:, 1]
        assert drawn.get_drawstyle() == look
        assert_allclose(np.c_[drawn.get_xdata(), drawn.get_ydata()], np.c_[x, getattr(found, y)])
        assert_allclose([edges.min(), edges.max()], [found.lower.min(), found.upper.max()])


def test_the_period_of_the_recording_is_that_of_the_responses(plain):
    slow = replace(plain, dt=10.0)
    assert slow.frequency_response([0.1]).dt == slow.step_response(3).time[1] == slow.noise_spectrum([0.1]).dt == 10.0
    assert slow.frequency_response([0.1], dt=2.0).dt == 2.0 and plain.frequency_response([0.1]).dt == 1.0
    with pytest.raises(ValueError, match="omega"):
        slow.frequency_response([1.0])
    with pytest.raises(ValueError, match="all with or all without a sampling period"):
        plotting.plot_bode({"a": plain, "b": slow})


def test_a_model_that_has_no_response_is_refused(recording, plain):
    y, u = recording.y, recording.u
    with pytest.raises(ValueError, match=r"ARX.*: expected a model with an input"):
        plotting.plot_bode(identify(y, None, ARX(2, 0)))
    with pytest.raises(ValueError, match="which: expected an input below 1"):
        plotting.plot_bode(plain, which=1)
    with pytest.raises(ValueError, match="input: expected 0 to 0"):
        plotting.plot_poles(plain, which=1)
    for call in (plotting.plot_bode, plotting.plot_poles):
        with pytest.raises(ValueError, match="LinearRegression"):
            call(identify(y, u, LinearRegression(1)))
        with pytest.raises(ValueError, match="at its start"):
            call(ParameterTracker(OutputError(2, 2)))
    assert not plt.get_fignums()


def test_bad_arguments_are_refused_by_name_and_nothing_is_drawn(plain):
    wrong = {"models": [{}, "model", {"a": 3}], "level": [95]}
    assert_refused(plotting.plot_poles, {"models": plain}, wrong)
    assert_refused(plotting.plot_bode, {"models": plain}, wrong | {"omega": [[0.1, 4.0]]})
    # What the right arguments have drawn.
    assert len(plt.get_fignums()) == 2
