"""Pictures show the numbers of their results, on the user's time axis, in the axes they are given."""

from dataclasses import replace

import matplotlib
import numpy as np
import pytest
import recordings
from filterpy.common import Saver
from numpy.testing import assert_allclose, assert_array_equal
from recordings import assert_refused

from robust_filterpy import ARX, OutputError, ParameterTracker, RobustKalmanFilter, identify, plotting
from robust_filterpy.identification import FIR, LinearRegression, StateSpace, compare, select_structure, validate

matplotlib.use("Agg")
import matplotlib.pyplot as plt

pd = pytest.importorskip("pandas")

N = 120


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


@pytest.fixture
def ax():
    return plt.figure().subplots()


@pytest.fixture(scope="module")
def batch():
    rng = np.random.default_rng(3)
    kf = RobustKalmanFilter(2, 1)
    kf.F, kf.H, kf.Q, kf.R = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), 0.01 * np.eye(2), np.eye(1)
    truth = 0.2 * np.arange(N)
    zs = truth + rng.normal(size=N) * np.where(rng.random(N) < 0.1, 20.0, 1.0)
    zs[50:60] = np.nan
    saver = Saver(kf)
    means, covariances, _, _ = kf.batch_filter(zs, saver=saver)
    return means, covariances, saver, zs, truth


@pytest.fixture(scope="module")
def run():
    y, u = recordings.recording(4, N, sigma=0.2, share=0.0, inside=True, a=[1.0, -0.8], b=[0.0, 1.0])
    return ParameterTracker(ARX(1, 1), R=0.04).run(y, u), y


def labels(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def test_states_show_each_mean_its_band_and_the_truth(ax, batch):
    means, covariances, _, zs, truth = batch
    out = plotting.plot_states(means, covariances, states=0, truth=truth, zs=zs, unit="m", time_unit="s", ax=ax)
    assert out is ax
    assert (ax.get_ylabel(), ax.get_xlabel()) == ("x[0] [m]", "time [s]")
    assert labels(ax) == ["±2 sigma", "x[0]", "x[0], true", "measured"]
    assert len(ax.lines) == 3 and len(ax.collections) == 1
    assert_array_equal(ax.lines[0].get_ydata(), means[:, 0, 0])
    band = ax.collections[0].get_paths()[0].get_extents()
    assert band.y1 == pytest.approx((means[:, 0, 0] + 2 * np.sqrt(covariances[:, 0, 0])).max())


def test_a_saver_shows_the_states_of_the_batch(ax, batch):
    plotting.plot_states(batch[2], ax=ax)
    assert len(ax.lines) == 2 and len(ax.collections) == 2
    assert_array_equal(ax.lines[1].get_ydata(), batch[0][:, 1, 0])


def test_innovations_mark_exactly_the_clipped(ax, batch):
    saver = batch[2]
    assert plotting.plot_innovations(saver, unit="m", ax=ax) is ax
    clipped = np.array(saver.clipped).ravel()
    y = np.array(saver.y).ravel()
    assert labels(ax) == ["±2 sigma", "innovation", "clipped"]
    assert 0 < clipped.sum() < N
    assert_array_equal(ax.lines[1].get_ydata(), y[clipped])
    # A missing sample has no innovation.
    assert np.isfinite(ax.lines[0].get_ydata()).sum() == N - 10 - clipped.sum()


def test_innovations_of_arrays_and_of_a_tracker_mark_what_was_weighed_down(ax, batch, run):
    saver = batch[2]
    plotting.plot_innovations(np.array(saver.y), np.array(saver.S), clipped=np.array(saver.clipped), ax=ax)
    assert len(ax.lines[1].get_ydata()) == np.sum(saver.clipped) and len(ax.collections) == 1
    ax.clear()
    plotting.plot_innovations(run[0], ax=ax)
    assert len(ax.lines[1].get_ydata()) == np.sum(run[0].weights < 1) > 0


def test_parameters_have_paths_bands_and_their_truth_in_the_legend(ax, run):
    result, _ = run
    assert result.plot(truth=[-0.8, 1.0], names=["pole", "gain"], ax=ax) is ax
    assert labels(ax) == ["±2 sigma", "pole", "pole, true", "gain", "gain, true"]
    assert len(ax.lines) == 4 and len(ax.collections) == 2
    assert_array_equal(ax.lines[2].get_ydata(), result.theta[:, 1])
    assert set(ax.lines[1].get_ydata()) == {-0.8} and ax.get_ylabel() == "parameter"


def test_the_first_band_does_not_flatten_the_paths(ax, run):
    result, _ = run
    assert result.std.max() > 5.0
    plotting.plot_states(result, ax=ax)
    assert len({line.get_linestyle() for line in ax.lines}) == len(ax.lines) == 2
    low, high = ax.get_ylim()
    assert low < -0.8 and 1.0 < high and high - low < 5.0


def test_after_six_lines_their_looks_come_again(ax):
    plotting.plot_states(np.zeros((5, 7)), np.tile(np.eye(7), (5, 1, 1)), ax=ax)
    looks = [(line.get_color(), line.get_linestyle()) for line in ax.lines]
    assert looks[6] == looks[0] and len(set(looks)) == 6


@pytest.mark.parametrize(("call", "match"), [
    (lambda m, c: plotting.plot_states(m, c[:-1]), "covariances: expected shape"),
    (lambda m, c: plotting.plot_states(m, c, t=[1.0]), "t: expected 120 times"),
    (lambda m, c: plotting.plot_states(m, c, states=2), "states: expected numbers below 2"),
    (lambda m, c: plotting.plot_states(m, c, names=["a"]), "names: expected 2"),
    (lambda m, c: plotting.plot_states(m, c, truth=[1.0]), "truth: expected shape"),
    (lambda m, c: plotting.plot_states(m, c, zs=m), "zs: expected 120"),
])  # fmt: skip
def test_what_does_not_fit_is_named_and_nothing_drawn(batch, call, match):
    before = plt.get_fignums()
    with pytest.raises(ValueError, match=match):
        call(batch[0], batch[1])
    assert plt.get_fignums() == before


@pytest.mark.parametrize("plot", [plotting.plot_states, plotting.plot_innovations])
@pytest.mark.parametrize("source", [RobustKalmanFilter(2, 1), None])
def test_a_filter_is_no_source(plot, source):
    before, got = plt.get_fignums(), type(source).__name__
    with pytest.raises(TypeError, match=rf"^source: expected a Saver or the result of tracker.run\(..\), got {got}$"):
        plot(source)
    assert plt.get_fignums() == before


def test_no_two_filters_look_alike_to_anybody():
    """Whatever colors are seen: each has a line of its own."""
    for look in ("linestyle", "color"):
        assert len({str(one[look]) for one in plotting.LOOKS.values()}) == len(plotting.LOOKS)


# Results of the workbench: validation, selection, comparison, runs, responses; legends outside the data.


@pytest.fixture(scope="module")
def recording():
    y, u = recordings.recording(1, 600, sigma=0.5)
    return pd.DataFrame({"y": y, "u": u}, index=pd.date_range("2024-03-01", periods=600, freq="10s"))


@pytest.fixture(scope="module")
def model(recording):
    return identify(recording.y, recording.u, OutputError(2, 2))


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
    assert plotting.plot_innovations(result).get_xlabel() == "time"


@pytest.mark.parametrize(("index", "label"), [
    (pd.date_range("2024-03-30", periods=3, freq="h", tz="Europe/Berlin"), "time"),
    (pd.period_range("2024-01", periods=3, freq="M"), "time"),
    ([pd.Timestamp("2024-01-01").to_pydatetime()] * 3, "time"),
    (pd.timedelta_range("0s", periods=3, freq="500ms"), "sample"),
    (pd.RangeIndex(3), "sample"),
], ids=["hours of a place", "periods", "datetimes", "durations", "count"])  # fmt: skip
def test_times_of_all_kinds_stand_on_the_axis(index, label):
    ax = plotting.plot_innovations(np.ones(3), t=index)
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
