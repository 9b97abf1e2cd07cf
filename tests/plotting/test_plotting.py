"""Each picture draws into the axes it is given and shows what its labels say."""


import matplotlib
import numpy as np
import pytest
from filterpy.common import Saver
from recordings import recording

from robust_filterpy import RobustKalmanFilter, plotting
from robust_filterpy.identification import ARX, ParameterTracker

matplotlib.use("Agg")
import matplotlib.pyplot as plt

N = 120


@pytest.fixture
def ax():
    figure, axes = plt.subplots()
    yield axes
    plt.close(figure)


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
    y, u = recording(4, N, sigma=0.2, share=0.0, inside=True, a=[1.0, -0.8], b=[0.0, 1.0])
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
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), means[:, 0, 0])
    band = ax.collections[0].get_paths()[0].get_extents()
    assert band.y1 == pytest.approx((means[:, 0, 0] + 2 * np.sqrt(covariances[:, 0, 0])).max())


def test_a_saver_shows_the_states_of_the_batch(ax, batch):
    plotting.plot_states(batch[2], ax=ax)
    assert len(ax.lines) == 2 and len(ax.collections) == 2
    np.testing.assert_array_equal(ax.lines[1].get_ydata(), batch[0][:, 1, 0])


def test_innovations_mark_exactly_the_clipped(ax, batch):
    saver = batch[2]
    assert plotting.plot_innovations(saver, unit="m", ax=ax) is ax
    clipped = np.array(saver.clipped).ravel()
    y = np.array(saver.y).ravel()
    assert labels(ax) == ["±2 sigma", "innovation", "clipped"]
    assert 0 < clipped.sum() < N
    np.testing.assert_array_equal(ax.lines[1].get_ydata(), y[clipped])
    # A missing sample has no innovation.
    assert np.isfinite(ax.lines[0].get_ydata()).sum() == N - 10 - clipped.sum()


def test_innovations_of_arrays_and_of_a_tracker_mark_what_was_weighed_down(ax, batch, run):
    saver = batch[2]
    plotting.plot_innovations(np.array(saver.y), np.array(saver.S), clipped=np.array(saver.clipped), ax=ax)
    assert len(ax.lines[1].get_ydata()) == np.sum(saver.clipped) and len(ax.collections) == 1
    ax.clear()
    plotting.plot_innovations(run[0], ax=ax)
    assert len(ax.lines[1].get_ydata()) == np.sum(run[0].weights < 1) > 0


@pytest.mark.parametrize("kind", ["saver", "array", "run"])
def test_weights_lie_between_zero_and_one(ax, batch, run, kind):
    saver = batch[2]
    source = {"saver": saver, "array": np.array(saver.weights), "run": run[0]}[kind]
    assert plotting.plot_weights(source, time_unit="s", ax=ax) is ax
    drawn = ax.lines[0].get_ydata()
    assert len(drawn) == N and np.nanmin(drawn) < 1.0 == np.nanmax(drawn)
    assert ax.get_ylabel() == "weight" and ax.get_xlabel() == "time [s]"


def test_parameters_have_paths_bands_and_their_truth_in_the_legend(ax, run):
    result, _ = run
    assert result.plot(truth=[-0.8, 1.0], names=["pole", "gain"], ax=ax) is ax
    assert labels(ax) == ["±2 sigma", "pole", "pole, true", "gain", "gain, true"]
    assert len(ax.lines) == 4 and len(ax.collections) == 2
    np.testing.assert_array_equal(ax.lines[2].get_ydata(), result.theta[:, 1])
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


@pytest.mark.parametrize("plot", [plotting.plot_states, plotting.plot_innovations, plotting.plot_weights])
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
